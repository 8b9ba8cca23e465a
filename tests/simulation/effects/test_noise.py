"""Effects on noise: spread, memory and bursts."""

import numpy as np
import pytest
from support.effect_bench import Bench, Recorded, effect

from tofmix.simulation.effects import PixelMap


@pytest.mark.parametrize("factor", [1.0, 1.3, 4.0])
def test_excess_noise_scales_each_deviation(bench: Bench, plain_wall: Recorded, factor: float) -> None:
    other = bench.wall(effect("excess_noise", factor=factor))
    deviation = plain_wall.range_mm - plain_wall.true_mm
    assert abs(other.range_mm - plain_wall.true_mm - factor * deviation).max() <= 0.5 * (1 + factor) + 0.01


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan])
def test_map_of_noise_with_a_value_that_is_no_factor_is_refused(bench: Bench, wrong: float) -> None:
    values = np.full((9, 11), 2.0, dtype=np.float32)
    values[3, 4] = wrong
    with pytest.raises(ValueError, match="map: every pixel needs a finite factor above 0"):
        bench.boards(effect("excess_noise", factor=1.0, map=PixelMap("", values)))


def test_excess_noise_of_one_surface_changes_its_samples_alone(bench: Bench) -> None:
    plain = bench.boards(frames=100)
    other = bench.boards(effect("excess_noise", factor=3.0, surface="far"), frames=100)
    far = plain.truth.surface.reshape(-1, 3) == 2
    amplitude = np.where(far, plain.truth.amplitude.reshape(-1, 3), np.nan)
    from_far = (plain.amplitude[..., np.newaxis] == amplitude).any(axis=-1)
    assert 0.05 < from_far.mean() < 0.5
    np.testing.assert_array_equal(other.stored[~from_far], plain.stored[~from_far])
    np.testing.assert_array_equal(other.amplitude, plain.amplitude)
    assert (other.stored[from_far] != plain.stored[from_far]).mean() > 0.8


@pytest.mark.parametrize("probability", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("sigma", [0.0, 50.0])
def test_interference_adds_in_quadrature_in_some_frames(
    bench: Bench, plain_wall: Recorded, probability: float, sigma: float
) -> None:
    other = bench.wall(effect("interference", probability=probability, sigma_mm=sigma))
    own = plain_wall.sigma(plain_wall.true_mm)
    gain = np.hypot(own, sigma) / own
    deviation = plain_wall.range_mm - plain_wall.true_mm
    error = [abs(other.range_mm - plain_wall.true_mm - g * deviation) - 0.51 * (1 + g) for g in (1.0, gain)]
    quiet, disturbed = ((e <= 0).all(axis=1) for e in error)
    assert (quiet | disturbed).all()
    if sigma:
        assert disturbed.all() == (probability == 1)
        assert quiet.all() == (probability == 0)


@pytest.mark.parametrize(("probability", "burst"), [(0.1, 5.0), (0.4, 2.0), (0.5, 20.0), (0.9, 5.0)])
def test_bursts_have_their_share_and_their_length(bench: Bench, probability: float, burst: float) -> None:
    from tofmix.simulation.exposure import drawn_truth

    one = effect("interference", probability=probability, sigma_mm=50.0, burst_frames=burst)
    model = bench.wall(one, frames=1).model
    n = 200_000
    (truth,) = drawn_truth(model, seed=1, n_frames=n)
    state = truth.values.astype(np.int64)
    stop = min(1 / burst, (1 - probability) / probability)
    memory = 1 - stop / (1 - probability)
    spread = (probability * (1 - probability) / n * (1 + memory) / (1 - memory)) ** 0.5
    assert state.mean() == pytest.approx(probability, abs=4 * spread)
    starts = (np.diff(state) == 1).sum()
    assert state.sum() / starts == pytest.approx(1 / stop, rel=4 / starts**0.5)
    np.testing.assert_array_equal(drawn_truth(model, seed=1, n_frames=50)[0].values, state[:50])


@pytest.mark.parametrize("coefficient", [0.0, 0.3, 0.8, -0.5])
def test_noise_remembers_the_frame_before(bench: Bench, coefficient: float) -> None:
    """Standardised deviations: variance 1, autocorrelation rho^k, on a wall that sees one surface."""
    n = 600
    other = bench.wall(effect("temporal_correlation", coefficient=coefficient), frames=n)
    e = (other.range_mm - other.true_mm) / np.hypot(other.sigma(other.true_mm), 12**-0.5)
    size = e.size * (1 - coefficient**2) / (1 + coefficient**2)
    assert e.var() == pytest.approx(1, abs=4 * (2 / size) ** 0.5)
    assert e[0].var() == pytest.approx(1, abs=4 * (2 / e.shape[1]) ** 0.5)
    for lag in (1, 2, 5):
        found = (e[lag:] * e[:-lag]).mean()
        assert found == pytest.approx(coefficient**lag, abs=5 * (1 / size) ** 0.5)
    assert abs((e[:, 1:] * e[:, :-1]).mean()) < 4 / size**0.5


def test_memory_runs_on_across_surfaces_and_random_values(bench: Bench) -> None:
    """Where an event is another than in the frame before, the standardised noise is correlated all the same."""
    one = effect("temporal_correlation", coefficient=0.7)
    other = bench.boards(one, frames=1500, outlier_probability=0.3)
    layers = other.truth.range_true.shape[2]
    amplitude = np.nan_to_num(other.truth.amplitude.reshape(-1, layers))
    event = abs(other.amplitude[..., np.newaxis] - amplitude).argmin(axis=-1)
    lit = other.amplitude > 0
    mean = np.nan_to_num(other.truth.range_true.reshape(-1, layers))[np.arange(99), event]
    e = (other.range_mm - mean) / other.sigma(mean)
    changed = lit[1:] & lit[:-1] & (event[1:] != event[:-1])
    product = (e[1:] * e[:-1])[changed]
    assert product.size > 1000
    assert product.mean() == pytest.approx(0.7, abs=5 * product.std() / product.size**0.5)
    across = lit[2:] & ~lit[1:-1] & lit[:-2]
    product = (e[2:] * e[:-2])[across]
    assert product.mean() == pytest.approx(0.49, abs=5 * product.std() / product.size**0.5)


def test_memory_does_not_depend_on_blocks_and_threads(bench: Bench) -> None:
    from tofmix.simulation.render import render_blocks

    recorded = bench.wall(effect("temporal_correlation", coefficient=0.7), frames=50)
    blocks = render_blocks(recorded.model, recorded.truth, n_frames=50, seed=3, block_frames=7, threads=3)
    ranges = np.concatenate([block.range_mm for block in blocks]).reshape(50, -1)
    np.testing.assert_array_equal(ranges, recorded.stored)
