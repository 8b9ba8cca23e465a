"""Effects that replace, lose, fold and round samples."""

import numpy as np
import pytest
from scipy import stats
from support.effect_bench import Bench, Recorded, effect


def share_is(found: float, expected: float, n: int) -> None:
    """Within four standard errors of a binomial share."""
    assert found == pytest.approx(expected, abs=4 * (expected * (1 - expected) / n) ** 0.5)


@pytest.mark.parametrize("probability", [0.0, 0.03, 0.4])
def test_outliers_are_uniform_and_replace_the_rest(bench: Bench, probability: float) -> None:
    plain, other = bench.boards(frames=600), bench.boards(effect("outliers", probability=probability), frames=600)
    changed = other.stored != plain.stored
    share_is(changed.mean(), probability, changed.size)
    assert not other.amplitude[changed].any()
    unlike = other.amplitude[~changed] != plain.amplitude[~changed]
    assert unlike.mean() < 1e-3  # a random value may happen to be the one that it replaced
    if probability:
        assert stats.kstest(other.stored[changed], stats.uniform(649.5, 6851).cdf).pvalue > 1e-3


@pytest.mark.parametrize("probability", [0.0, 0.1, 1.0])
def test_dropout_loses_the_given_share_at_random(bench: Bench, probability: float) -> None:
    plain, other = bench.boards(frames=300), bench.boards(effect("dropout", probability=probability), frames=300)
    lost = other.stored == 0
    np.testing.assert_array_equal(other.stored[~lost], plain.stored[~lost])
    share_is(lost.mean(), 0.98 * probability, lost.size)  # random values are never lost


@pytest.mark.parametrize(("threshold", "noise"), [(0.0, 0.0), (60.0, 0.0), (60.0, 15.0), (200.0, 50.0)])
def test_dropout_threshold_loses_dark_samples(bench: Bench, threshold: float, noise: float) -> None:
    one = effect("dropout", threshold=threshold, threshold_noise=noise)
    other = bench.wall(one, frames=400)
    lost = (other.stored == 0).mean(axis=0)
    short = threshold - other.true_amplitude
    expected = stats.norm.cdf(short / noise) if noise else (short > 0).astype(float)
    variance = expected * (1 - expected) / 400
    normal = variance > 5 / 400**2
    assert (abs(lost - expected)[normal] <= 5 * np.sqrt(variance[normal])).all()
    assert (abs(lost - expected)[~normal] < 0.03).all()
    if noise == 15.0:
        assert (expected > 0.1).any()
        assert (expected < 0.9).any()


@pytest.mark.parametrize("well", [1e9, 150.0, 40.0])
def test_saturation_loses_bright_samples(bench: Bench, plain_wall: Recorded, well: float) -> None:
    other = bench.wall(effect("saturation", full_well_amplitude=well))
    lost = other.true_amplitude > well
    assert np.array_equal((other.stored == 0), np.broadcast_to(lost, other.stored.shape))
    np.testing.assert_array_equal(other.stored[:, ~lost], plain_wall.stored[:, ~lost])
    assert lost.mean() == 0 if well == 1e9 else 0 < lost.mean() < 1


@pytest.mark.parametrize("share", [0.0, 0.05, 0.5])
def test_stuck_pixels_return_one_value(bench: Bench, share: float) -> None:
    big = {"rows": 60, "cols": 100}
    plain = bench.wall(frames=3, **big)
    other = bench.wall(
        effect("stuck_pixels", share=share, value_mm=40_000), effect("dropout", probability=0.5), frames=3, **big
    )
    stuck = (other.stored == 40_000).all(axis=0)
    share_is(stuck.mean(), share, stuck.size)
    rest = other.stored[:, ~stuck]
    np.testing.assert_array_equal(rest[rest > 0], plain.stored[:, ~stuck][rest > 0])


@pytest.mark.parametrize("step", [0.0, 0.3, 7.3, 250.0])
def test_ranges_are_multiples_of_the_step(bench: Bench, step: float) -> None:
    """Every range, whatever its event."""
    plain, other = bench.boards(), bench.boards(effect("quantisation", step_mm=step))
    if step == 0:
        np.testing.assert_array_equal(other.stored, plain.stored)
        return
    nearest = np.rint(np.rint(other.range_mm / step) * step)
    np.testing.assert_allclose(other.range_mm, nearest, atol=0.51 * (step < 1))
    assert abs(other.range_mm - plain.range_mm).max() <= step / 2 + 1


@pytest.mark.parametrize("period", [1e6, 3000.0, 1400.0])
def test_ranges_fold_at_the_given_length(bench: Bench, plain_wall: Recorded, period: float) -> None:
    other = bench.wall(effect("phase_wrapping", unambiguous_range_mm=period))
    folded = np.mod(plain_wall.range_mm, period)
    error = np.minimum(abs(other.range_mm - folded), period - abs(other.range_mm - folded))
    assert error.max() <= 1  # the edge of a turn: rounded to 0 and stored as 1, or to the period
    assert other.stored.min() >= 1
    assert other.stored.max() <= min(period, 65_534)


def test_folding_takes_bias_and_noise_along_and_leaves_no_return(bench: Bench) -> None:
    effects = (effect("phase_wrapping", unambiguous_range_mm=3000.0), effect("range_offset", offset_mm=700.0))
    plain, other = bench.boards(), bench.boards(*effects)
    lit = plain.amplitude > 0
    expected = np.where(lit, np.mod(plain.range_mm + 700, 3000), plain.range_mm)
    error = abs(other.range_mm - expected)
    assert np.minimum(error, 3000 - error)[lit].max() <= 1
    np.testing.assert_array_equal(other.stored[~lit], plain.stored[~lit])


def test_fold_length_defaults_to_that_of_the_sensor(bench: Bench) -> None:
    other = bench.wall(effect("phase_wrapping"), modulation_frequency_hz=50e6)
    same = bench.wall(effect("phase_wrapping", unambiguous_range_mm=2997.92458), modulation_frequency_hz=50e6)
    np.testing.assert_array_equal(other.stored, same.stored)
    assert other.stored.max() < 3000
