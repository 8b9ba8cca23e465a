"""Effects on phasors: ranges, amplitudes and sigmas against complex arithmetic written out here."""

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from support.effect_bench import Bench, Recorded, effect

from tofmix.circle import unambiguous_range_mm

Complex = NDArray[np.complex128]
TURN = unambiguous_range_mm(20e6)


def phasor(range_mm: ArrayLike, amplitude: ArrayLike) -> Complex:
    turns = np.asarray(range_mm, dtype=np.float64) / TURN
    return np.asarray(np.asarray(amplitude) * np.exp(2j * np.pi * turns), dtype=np.complex128)


def follows(plain: Recorded, other: Recorded, z: Complex, new: Complex) -> None:
    """Each sample of `other` is that of `plain` with z replaced: mean, amplitude and noise."""
    old_sigma = plain.sigma(plain.true_mm)
    noise = (plain.range_mm - plain.true_mm) / old_sigma
    turned = np.angle(new / z) * TURN / (2 * np.pi)
    expected = plain.true_mm + turned + noise * old_sigma * abs(z) / abs(new)
    slack = 0.5 * (1 + abs(z) / abs(new)) + 0.01  # both were rounded
    assert (abs(other.range_mm - expected) <= slack).all()
    np.testing.assert_allclose(other.amplitude, np.broadcast_to(abs(new), other.amplitude.shape), rtol=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.4])
@pytest.mark.parametrize("path", [0.0, 800.0, 5000.0])
def test_a_second_path_multiplies_the_phasor(bench: Bench, plain_wall: Recorded, share: float, path: float) -> None:
    other = bench.wall(effect("multipath", surface="wall", share=share, extra_path_mm=path))
    z = phasor(plain_wall.true_mm, plain_wall.true_amplitude)
    second = phasor(plain_wall.true_mm + path / 2, share * plain_wall.true_amplitude)
    follows(plain_wall, other, z, z + second)


def test_a_second_path_leads_to_one_surface(bench: Bench) -> None:
    plain = bench.boards(frames=100)
    other = bench.boards(effect("multipath", surface="far", share=0.4, extra_path_mm=900), frames=100)
    far = plain.truth.surface.reshape(-1, 3) == 2
    amplitude = np.where(far, plain.truth.amplitude.reshape(-1, 3), np.nan)
    from_far = (plain.amplitude[..., np.newaxis] == amplitude).any(axis=-1)
    assert 0.05 < from_far.mean() < 0.5
    np.testing.assert_array_equal(other.stored[~from_far], plain.stored[~from_far])
    assert (other.stored[from_far] != plain.stored[from_far]).mean() > 0.9


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3])
def test_stray_light_is_a_share_of_the_mean_phasor(bench: Bench, plain_wall: Recorded, share: float) -> None:
    z = phasor(plain_wall.true_mm, plain_wall.true_amplitude)
    follows(plain_wall, bench.wall(effect("scattering", share=share)), z, z + share * z.mean())


@pytest.mark.parametrize("amplitude", [0.0, 3.0, 15.0])
@pytest.mark.parametrize("range_mm", [20.0, -600.0])
def test_internal_reflection_adds_one_phasor_to_every_pixel(
    bench: Bench, plain_wall: Recorded, amplitude: float, range_mm: float
) -> None:
    z = phasor(plain_wall.true_mm, plain_wall.true_amplitude)
    other = bench.wall(effect("internal_reflection", amplitude=amplitude, range_mm=range_mm))
    follows(plain_wall, other, z, z + phasor(range_mm, amplitude))


@pytest.mark.parametrize("factor", [1.0, 1.5, 4.0])
def test_light_falls_off_towards_the_corner(bench: Bench, plain_wall: Recorded, factor: float) -> None:
    other = bench.wall(effect("vignetting", corner_factor=factor))
    azimuth = np.radians((np.arange(40) - 19.5) * 50 / 40)
    elevation = np.radians((np.arange(6) - 2.5) * 8 / 6)
    cosine = np.outer(np.cos(elevation), np.cos(azimuth)).ravel()
    light = np.exp(-np.log(factor) * np.log(cosine) / np.log(cosine[0]))
    assert light[[0, 39, -1]] == pytest.approx(1 / factor)
    z = phasor(plain_wall.true_mm, plain_wall.true_amplitude)
    follows(plain_wall, other, z, light * z)


@pytest.mark.parametrize("share", [0.0, 0.03, 0.1])
def test_crosstalk_mixes_neighbours(bench: Bench, plain_wall: Recorded, share: float) -> None:
    """Each pixel of the wall has one phasor, so that its neighbours' are known; the image's edge repeats."""
    z = phasor(plain_wall.true_mm, plain_wall.true_amplitude).reshape(6, 40)
    mixed = np.empty_like(z)
    for row in range(6):
        for col in range(40):
            around = [(max(row - 1, 0), col), (min(row + 1, 5), col), (row, max(col - 1, 0)), (row, min(col + 1, 39))]
            mixed[row, col] = (1 - 4 * share) * z[row, col] + share * sum(z[place] for place in around)
    follows(plain_wall, bench.wall(effect("pixel_crosstalk", share=share)), z.ravel(), mixed.ravel())


def test_crosstalk_carries_the_neighbours_events(bench: Bench) -> None:
    """Beside a mixed pixel, the range goes with the event that the neighbour has in the same frame."""
    plain = bench.boards(frames=400, outlier_probability=0.0)
    other = bench.boards(effect("pixel_crosstalk", share=0.1), frames=400, outlier_probability=0.0)
    moved = (other.range_mm - plain.range_mm).reshape(400, 9, 11)
    event = plain.amplitude.reshape(400, 9, 11)
    n_modes, full = plain.truth.n_modes, plain.truth.weight_no_return == 0
    pairs = 0
    for row, col in zip(*np.nonzero((n_modes == 1) & full), strict=True):
        for beside in (col - 1, col + 1):
            if 0 <= beside < 11 and n_modes[row, beside] == 2 and full[row, beside]:
                bright = event[:, row, beside] > event[:, row, beside].mean()
                if 40 < bright.sum() < 360:
                    noise = moved[:, row, col].std()
                    difference = moved[bright, row, col].mean() - moved[~bright, row, col].mean()
                    pairs += abs(difference) > noise / 2
    assert pairs > 0


@pytest.mark.parametrize(
    "probability", [pytest.param(0.0, marks=pytest.mark.slow), 0.35, pytest.param(1.0, marks=pytest.mark.slow)]
)
def test_flying_samples_are_the_phasor_sum(bench: Bench, probability: float) -> None:
    """Pixels that see several surfaces, or a surface and nothing: a share of all samples is the sum of all."""
    plain = bench.boards(frames=2000, outlier_probability=0.0)
    other = bench.boards(effect("flying_pixels", probability=probability), frames=2000, outlier_probability=0.0)
    layers = plain.truth.range_true.shape[2]
    ranges = np.nan_to_num(plain.truth.range_true).reshape(-1, layers)
    share = np.nan_to_num(plain.truth.weight_true).reshape(-1, layers)
    amplitude = plain.truth.amplitude.reshape(-1, layers)
    mixed = (share * phasor(ranges, amplitude)).sum(axis=1)
    n_modes, gap = plain.truth.n_modes.ravel(), plain.truth.weight_no_return.ravel() > 0
    mixes = (n_modes > 1) | ((n_modes > 0) & gap)
    assert (mixes & (n_modes == 1)).any()
    flown = mixes & (abs(other.amplitude - abs(mixed)) < 1e-4 * abs(mixed))
    np.testing.assert_array_equal(other.stored[:, ~mixes], plain.stored[:, ~mixes])
    returned = plain.amplitude > 0
    for events in (returned, ~returned):
        trials = (events & mixes).sum()
        spread = (probability * (1 - probability) / trials) ** 0.5
        assert (flown & events).sum() / trials == pytest.approx(probability, abs=4 * spread)
    if probability:
        at = np.nonzero(flown)
        middle = np.angle(mixed)[at[1]] % (2 * np.pi) * TURN / (2 * np.pi)
        error = other.range_mm[at] - middle
        from_mm, light = np.empty(len(at[0])), np.empty(len(at[0]))
        for k, (frame, pixel) in enumerate(zip(*at, strict=True)):
            own = amplitude[pixel]
            dark = plain.amplitude[frame, pixel] == 0
            event = np.argmax(share[pixel] * own) if dark else np.argmin(abs(own - plain.amplitude[frame, pixel]))
            from_mm[k], light[k] = ranges[pixel, event], own[event]
        z = error / np.hypot(plain.sigma(from_mm) * light / other.amplitude[at], 12**-0.5)
        for some in (plain.amplitude[at] > 0, plain.amplitude[at] == 0):
            n = some.sum()
            assert abs(z[some].mean()) < 4 / n**0.5
            assert z[some].var() == pytest.approx(1, abs=4 * (2 / n) ** 0.5)


def test_mixed_sample_of_a_surface_and_open_space_keeps_the_range(bench: Bench) -> None:
    """No no-return sample is left; the range is the surface's, the amplitude its share, sigma over the share."""
    recorded = bench.boards(effect("flying_pixels", probability=1.0), frames=2000, outlier_probability=0.0)
    truth = recorded.truth
    some = ((truth.n_modes == 1) & (truth.weight_no_return > 0.3) & (truth.weight_no_return < 0.7)).ravel()
    assert some.any()
    share = truth.weight_true.reshape(some.size, -1)[some, 0].astype(np.float64)
    true_mm, light = recorded.true_mm[some], recorded.true_amplitude[some]
    np.testing.assert_allclose(
        recorded.amplitude[:, some], np.broadcast_to(share * light, (2000, some.sum())), rtol=1e-5
    )
    sigma = np.hypot(recorded.sigma(true_mm) / share, 12**-0.5)
    z = (recorded.range_mm[:, some] - true_mm) / sigma
    assert abs(z).max() < 6
    assert abs(z.mean()) < 4 / z.size**0.5
    assert z.var() == pytest.approx(1, abs=4 * (2 / z.size) ** 0.5)


def test_light_acts_in_file_order(bench: Bench, plain_wall: Recorded) -> None:
    """Stray light of a vignetted image, or vignetting of an image with stray light: both, by hand."""
    scattering, vignetting = effect("scattering", share=0.2), effect("vignetting", corner_factor=3.0)
    light = bench.wall(vignetting).amplitude[0] / plain_wall.amplitude[0]
    z = phasor(plain_wall.true_mm, plain_wall.true_amplitude)
    follows(plain_wall, bench.wall(scattering, vignetting), z, (z + 0.2 * z.mean()) * light)
    follows(plain_wall, bench.wall(vignetting, scattering), z, z * light + 0.2 * (z * light).mean())


def test_dark_and_cancelled_light_stays_finite(bench: Bench) -> None:
    dark = bench.boards(effect("scattering", share=0.5), integration_time_ms=1e-12, exponent=0.0)
    assert dark.stored.min() > 0
    gone = bench.wall(effect("multipath", surface="wall", share=1.0, extra_path_mm=TURN))
    assert np.isfinite(gone.amplitude).all()
    assert set(np.unique(gone.stored)) <= {1, 65_534}
