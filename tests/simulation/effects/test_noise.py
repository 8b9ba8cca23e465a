"""Effects on noise: spread, memory and bursts."""

from dataclasses import replace

import numpy as np
import pytest
from support.effect_bench import Bench, Floats, Recorded, effect

from tofmix.optics.projection import beam_directions_of
from tofmix.simulation.effects import PixelMap
from tofmix.simulation.effects.base import Context
from tofmix.simulation.exposure import predict


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


def cosines(recorded: Recorded, normal: tuple[float, float, float]) -> Floats:
    """Cosine (pixel,) of the angle between each pixel's beam and a plane's normal."""
    sensor = recorded.model.sensor
    beams = beam_directions_of(sensor.optics, sensor.shape).reshape(-1, 3)
    return np.asarray(np.abs(beams @ (np.array(normal) / np.linalg.norm(normal))))


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_noise_by_angle_is_divided_by_a_power_of_the_cosine_of_incidence(
    bench: Bench, plain_wall: Recorded, exponent: float
) -> None:
    """The wall has a yaw of 50 degrees: its beams meet it at 25 to 75 degrees."""
    other = bench.wall(effect("excess_noise", factor=1.2, angle_exponent=exponent))
    yaw = np.radians(50)
    factor = 1.2 * cosines(plain_wall, (np.sin(yaw), 0.0, np.cos(yaw))) ** -exponent
    assert factor.max() > 1.2 * 1.8**exponent * factor.min() / 1.2
    deviation = plain_wall.range_mm - plain_wall.true_mm
    error = abs(other.range_mm - plain_wall.true_mm - factor * deviation)
    assert (error <= 0.5 * (1 + factor) + 0.02 * abs(factor * deviation)).all()  # a pixel's cosine is that of its mean
    np.testing.assert_array_equal(other.amplitude, plain_wall.amplitude)


def test_noise_by_angle_is_that_of_the_place_where_a_surface_stands(bench: Bench, plain_wall: Recorded) -> None:
    """A wall that is turned to face the camera has hardly more noise than the curve."""
    facing = bench.wall(effect("surface_pose", surface="wall", shift_mm=0.0, yaw_deg=-50.0))
    noisy = effect("excess_noise", factor=1.0, angle_exponent=3.0)
    turned = predict(replace(facing.model, effects=(*facing.model.effects, noisy)), facing.truth)
    ratio = turned.sigma_mm[0] / facing.sigma(facing.true_mm)
    np.testing.assert_allclose(ratio, cosines(facing, (0.0, 0.0, 1.0)) ** -3.0, rtol=0.02)
    assert ratio.max() < 1.5
    as_modelled = predict(replace(plain_wall.model, effects=(noisy,)), plain_wall.truth)
    assert (as_modelled.sigma_mm[0] / plain_wall.sigma(plain_wall.true_mm)).max() > 10


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


def test_beat_adds_noise_in_proportion_to_the_overlap(bench: Bench, plain_wall: Recorded) -> None:
    """The overlap rises and falls evenly, within the share of disturbed frames, and repeats after the period."""
    period, share = 8.0, 0.5
    beating = effect("interference", probability=share, sigma_mm=80.0, period_frames=period)
    other, frames = bench.wall(beating), np.arange(20)
    context = Context(sensor=other.model.sensor, surfaces=("wall",), seed=3)
    part = beating.prepare(context, 20)
    np.testing.assert_allclose(part[:12], part[8:])
    assert (part > 0).mean() == pytest.approx(share, abs=0.1)
    triangles = [np.interp((frames - s) % period, [0, 2, 4, period], [0, 1, 0, 0]) for s in np.arange(0, period, 0.01)]
    assert min(abs(part - triangle).max() for triangle in triangles) < 0.01
    np.testing.assert_array_equal(beating.prepare(context, 9), part[:9])
    own = plain_wall.sigma(plain_wall.true_mm)
    gain = np.hypot(own, 80.0 * part[:, None]) / own
    deviation = plain_wall.range_mm - plain_wall.true_mm
    assert (abs(other.range_mm - plain_wall.true_mm - gain * deviation) <= 0.51 * (1 + gain)).all()
    (truth,) = beating.truth(part)
    assert truth.values.dtype == np.float32


def test_map_of_interference_is_the_part_of_the_noise_of_each_pixel(bench: Bench, plain_wall: Recorded) -> None:
    values = np.linspace(0, 1, 240, dtype=np.float32).reshape(6, 40)
    other = bench.wall(effect("interference", probability=1.0, sigma_mm=50.0, map=PixelMap("", values)))
    own = plain_wall.sigma(plain_wall.true_mm)
    gain = np.hypot(own, 50.0 * values.ravel()) / own
    deviation = plain_wall.range_mm - plain_wall.true_mm
    assert (abs(other.range_mm - plain_wall.true_mm - gain * deviation) <= 0.51 * (1 + gain)).all()


@pytest.mark.parametrize(
    ("numbers", "hides"),
    [
        ({"probability": 1.0}, False),
        ({"probability": 0.99}, True),
        ({"probability": 1.0, "period_frames": 30.0}, True),
    ],
    ids=["always", "bursts", "beat"],
)
def test_only_a_camera_that_is_always_on_hides_nothing(numbers: dict[str, float], hides: bool) -> None:
    assert effect("interference", sigma_mm=30.0, **numbers).hides is hides


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
