"""Noise of a model: a shape, widths, a background, amplitudes; what is drawn, and what is predicted."""

import io
import math
import re
import tomllib
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from support.effect_bench import Bench, Floats, effect, light_alone
from support.noise_parts import long_tailed, model_text, sensor_text, shape_keys, skewed, with_noise
from support.transform import pit

from tofmix.errors import BadInputError
from tofmix.io import hdf5, sensor_group
from tofmix.io.model_file import load_model
from tofmix.noise_shape import NoiseShape
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.events import event_table
from tofmix.simulation.exposure import drawn_truth, predict
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import explain, parse_model
from tofmix.simulation.render import recording_sensor, render_blocks

SEED = 11
SHAPES = {
    "skewed": skewed(),
    "long-tailed": long_tailed(),
    "with a corner": NoiseShape.standardised([-2.0, -1.0, 0.5, 3.0], [0.0, 0.7, 0.2, 0.0]),
}
LIMIT = 1.63
"""Of sqrt(n) times the Kolmogorov-Smirnov distance: 1 % of samples that are of the distribution exceed it."""


def model(parts: str = "", effects: str = "") -> Model:
    return parse_model(model_text(parts, effects), source="model.toml")


def frames(scene: Model, count: int, *, averaged: bool = False) -> NDArray[np.float64]:
    """Ranges (frame, row, col), mm."""
    blocks = render_blocks(scene, cast_scene(scene), n_frames=count, seed=SEED, averaged=averaged)
    return np.concatenate([block.range_mm for block in blocks]).astype(np.float64)


def standardised(scene: Model, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(x - r) / sigma(r) (frame, pixel) of pixels that see one surface alone, spread within whole mm; and their r."""
    truth, samples = cast_scene(scene), frames(scene, count)
    alone = (truth.n_modes == 1) & (truth.weight_no_return == 0)
    assert alone.sum() >= 40
    samples = samples[:, alone] + np.random.default_rng(1).uniform(-0.5, 0.5, (count, int(alone.sum())))
    range_mm = truth.range_true[alone][:, 0].astype(np.float64)
    noise = scene.sensor.noise_at(scene.sensor.integration_time_ms)
    return (samples - range_mm) / noise.sigma(range_mm), range_mm


@pytest.mark.parametrize("name", list(SHAPES))
def test_samples_have_the_distribution_of_the_shape(name: str) -> None:
    scene = with_noise(model(), shape=SHAPES[name])
    scene = replace(scene, sensor=replace(scene.sensor, outlier_probability=0.0))
    z, _ = standardised(scene, 200)
    # Whole mm add a uniform error of at most 0.5 mm to a sigma of 26 mm and more: a distance of some 1e-4.
    distance = stats.kstest(SHAPES[name].cdf(z.ravel()), "uniform").statistic
    assert distance * np.sqrt(z.size) < LIMIT
    wrong = stats.ks_1samp(z.ravel(), stats.norm.cdf).statistic
    assert wrong * np.sqrt(z.size) > LIMIT  # the test can tell it from a Gaussian


def test_without_parts_samples_are_those_of_equation_1_drawn_by_hand() -> None:
    """The random stream of a frame gives u, a normal number, and the random values, in this order, and no more."""
    scene = model()
    seen, made = cast_scene(scene), frames(scene, 5).reshape(5, -1)
    share = np.concatenate([np.nan_to_num(seen.weight_true), seen.weight_no_return[..., None]], axis=-1)
    top = np.full((8, 12, 1), scene.sensor.range_max_mm)
    ranges = np.concatenate([np.nan_to_num(seen.range_true), top], axis=-1).reshape(96, -1)
    sigma = scene.sensor.noise_at(2.0).sigma(ranges)
    ends = np.cumsum(share.reshape(96, -1).astype(np.float64), axis=1)
    for frame in range(5):
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(SEED, spawn_key=(frame,))))
        u, normal = rng.random(96), rng.standard_normal(96)
        random = u >= 0.99
        event = np.minimum((u[:, None] >= ends).sum(axis=1), np.flatnonzero(np.ones(ranges.shape[1]))[-1])
        event = np.where((seen.weight_no_return.ravel() == 0), np.minimum(event, seen.n_modes.ravel() - 1), event)
        at = np.arange(96), event
        value = ranges[at] + normal * sigma[at]
        value[random] = rng.uniform(scene.sensor.range_min_mm, scene.sensor.range_max_mm, int(random.sum()))
        np.testing.assert_array_equal(made[frame], np.clip(np.rint(value), 1, 65_534))


def test_memory_leaves_the_shape_and_links_normal_scores() -> None:
    shape, rho = SHAPES["skewed"], 0.6
    scene = model("", f'[[effect]]\nkind = "temporal_correlation"\ncoefficient = {rho}\n')
    scene = with_noise(replace(scene, sensor=replace(scene.sensor, outlier_probability=0.0)), shape=shape)
    z, _ = standardised(scene, 1500)
    every = z[::12]  # 0.6^12 = 0.002: as good as independent
    assert stats.kstest(shape.cdf(every.ravel()), "uniform").statistic * np.sqrt(every.size) < LIMIT
    score = stats.norm.ppf(np.clip(shape.cdf(z), 1e-9, 1 - 1e-9))
    found = (score[1:] * score[:-1]).mean() / (score**2).mean()
    assert found == pytest.approx(rho, abs=0.01)  # standard error 0.003; whole mm take 0.001


def test_widths_are_log_normal_one_a_pixel_and_in_the_truth() -> None:
    spread = 0.3
    scene = model(f"width_spread = {spread}")
    scene = replace(scene, sensor=replace(scene.sensor, outlier_probability=0.0))
    z, _ = standardised(scene, 2000)
    truth = next(t for t in drawn_truth(scene, seed=SEED, n_frames=2000) if t.name == "noise_width")
    seen = cast_scene(scene)
    drawn = truth.values[(seen.n_modes == 1) & (seen.weight_no_return == 0)]
    np.testing.assert_allclose(z.std(axis=0) / drawn, 1.0, atol=5 / np.sqrt(2 * 2000))
    halves = z[:1000].std(axis=0), z[1000:].std(axis=0)
    assert np.corrcoef(*halves)[0, 1] > 0.98  # one draw for the whole recording
    large = replace(scene, sensor=replace(scene.sensor, rows=100, cols=100))
    logs = np.log(drawn_truth(large, seed=SEED, n_frames=1)[0].values)
    assert logs.std() == pytest.approx(spread, abs=4 * spread / np.sqrt(2 * logs.size))
    assert abs(logs.mean()) < 4 * spread / np.sqrt(logs.size)
    other = drawn_truth(large, seed=SEED + 1, n_frames=1)[0].values
    assert not np.array_equal(np.exp(logs), other)


def test_widths_scale_sigma_after_all_effects() -> None:
    parts, effect = "width_spread = 0.5", '[[effect]]\nkind = "excess_noise"\nfactor = 2.0\n'
    once, twice = (standardised(model(parts, e), 400)[0] for e in ("", effect))
    near = [np.quantile(z, 0.8413, axis=0) - np.quantile(z, 0.1587, axis=0) for z in (once, twice)]
    np.testing.assert_allclose(near[1] / near[0], 2.0, rtol=0.05)


def background_map(shape: tuple[int, int] = (8, 12)) -> NDArray[np.float32]:
    return np.linspace(0.0, 0.5, shape[0] * shape[1], dtype=np.float32).reshape(shape)


@pytest.mark.parametrize("effect", ["", '[[effect]]\nkind = "outliers"\nprobability = 0.1\n'])
def test_background_has_its_share_in_each_pixel_and_the_truth_the_rest(effect: str) -> None:
    scene, count = with_noise(model("", effect), background=background_map()), 3000
    seen, samples = cast_scene(scene), frames(scene, count)
    low, high = scene.sensor.range_min_mm, scene.sensor.range_max_mm
    reach = 6 * float(scene.sensor.noise_at(2.0).sigma(high))
    far = np.where(seen.weight_no_return > 0, high, np.nan)
    places = np.concatenate([seen.range_true, far[..., None]], axis=-1)

    def near(range_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether ranges (n, row, col) may be of a surface of their pixel, or of no return."""
        return np.asarray(
            sum(np.abs(range_mm - np.nan_to_num(p, nan=-1e9)) < reach for p in np.moveaxis(places, -1, 0))
        )

    grid = np.broadcast_to(np.linspace(low, high, 4001)[:, None, None], (4001, 8, 12))
    free = 1.0 - near(grid).astype(bool).mean(axis=0)  # part of the working range in which random values stand alone
    share = 0.01 + background_map() + (0.1 if effect else 0.0)
    expected = share * free
    found = (~near(samples).astype(bool)).mean(axis=0)
    error = np.sqrt(expected * (1 - expected) / count)
    assert np.abs((found - expected) / error).max() < 4.5  # of 96 pixels: one such test in 1500 is beyond
    total = np.nansum(seen.weight_true, axis=-1) + seen.weight_no_return
    np.testing.assert_allclose(total, 1.0 - share, atol=1e-6)


PARTS = shape_keys(SHAPES["skewed"]) + "width_spread = 0.2\nbackground = 0.05\n"


def test_prediction_with_all_parts_is_that_of_the_samples_also_where_they_fold() -> None:
    scene = model(PARTS, '[[effect]]\nkind = "excess_noise"\nfactor = 1.3\n')
    samples = frames(scene, 400).reshape(400, -1)
    score = pit(predict(scene, seed=SEED), samples, np.random.default_rng(3))
    assert np.isfinite(score).all()
    assert stats.kstest(score.ravel(), "uniform").statistic * np.sqrt(score.size) < LIMIT
    gaussian = pit(predict(with_noise(scene, shape=None), seed=SEED), samples, np.random.default_rng(3))
    assert stats.kstest(gaussian.ravel(), "uniform").statistic * np.sqrt(score.size) > LIMIT
    scene = model(PARTS, '[[effect]]\nkind = "phase_wrapping"\nunambiguous_range_mm = 1000.0\n')
    samples = frames(scene, 300).reshape(300, -1)
    score = pit(predict(scene, seed=SEED), samples, np.random.default_rng(3))
    assert np.isfinite(score).all()
    assert stats.kstest(score.ravel(), "uniform").statistic * np.sqrt(score.size) < LIMIT


def test_model_reads_its_parts_and_a_recording_carries_them() -> None:
    scene = model(PARTS)
    noise = scene.sensor.noise
    assert noise.shape is not None
    assert noise.shape.same_as(SHAPES["skewed"])
    assert noise.width_spread == 0.2
    recorded = recording_sensor(scene).noise
    assert recorded is not None
    assert recorded.same_as(noise.scaled(2.0))  # 2 ms of 8: sigma is twice as large, all else the same
    averaged = recording_sensor(scene, averaged=True).noise
    assert averaged is not None
    assert averaged.shape is None
    assert averaged.background is None
    assert averaged.width_spread == 0.2


def test_background_is_read_from_the_folder_and_bounded(tmp_path: Path) -> None:
    np.save(tmp_path / "share.npy", background_map())
    path = tmp_path / "model.toml"
    path.write_text(model_text('background = "share.npy"'))
    background = load_model(str(path)).sensor.noise.background
    assert background is not None
    np.testing.assert_array_equal(background, background_map().astype(np.float64))
    with pytest.raises(BadInputError, match=r"probability: 0\.5 is not below 0\.39"):
        model("background = 0.6", '[[effect]]\nkind = "outliers"\nprobability = 0.5\n')


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        ("shape_z = [-1.0, 0.0, 1.0]", r"\[sensor.noise\]: shape_z alone; shape_z and shape_density go together"),
        ("shape_z = [-1.0, 1.0, 0.0]\nshape_density = [1.0, 1.0, 1.0]", "shape_z and shape_density: its z do not asc"),
        (
            "shape_z = [0.0, 1.0, 2.0]\nshape_density = [1.0, 1.0, 1.0]",
            "shape_density: expected median 0 and half width 1",
        ),
        ('shape_z = "skewed"\nshape_density = [1.0]', "shape_z: expected a list of numbers, got a string"),
        ("width_spread = -0.1", "width_spread -0.1 is not 0 to 2"),
        ("width_spread = true", "width_spread: expected a number, got a boolean"),
        ("background = 1.0", "background must be one share"),
        ("background = 0.995", "background: 0.995 is not below 0.99, 1 less outlier_probability"),
        ('background = "share.npy"', "background: a camera without a file has no folder for a map"),
        ("background = [0.1]", "background: expected a number, got a list"),
        ("widths = 0.3", '"widths" is not a key here'),
    ],
)
def test_unfit_parts_are_refused_in_one_line(parts: str, reason: str) -> None:
    with pytest.raises(BadInputError, match=reason) as refused:
        model(parts)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (np.zeros((12, 8), np.float32), r"shape \(12, 8\) differs from the image \(8, 12\)"),
        (np.full((8, 12), 1.5, np.float32), "background must be"),
        (np.full((8, 12), np.nan, np.float32), "background must be"),
        (np.zeros((8, 12), np.int64), "expected float32"),
    ],
)
def test_unfit_map_is_refused(tmp_path: Path, values: NDArray[np.float32], reason: str) -> None:
    np.save(tmp_path / "share.npy", values)
    (tmp_path / "model.toml").write_text(model_text('background = "share.npy"'))
    with pytest.raises(BadInputError, match=reason):
        load_model(str(tmp_path / "model.toml"))


def test_explain_describes_the_noise() -> None:
    said = explain(model(PARTS))
    assert "of its own shape, skewness 0.99" in said or "of its own shape, skewness 1" in said
    assert "a spread of its logarithm of 0.2" in said
    assert "background: 5 % of the samples" in said
    assert "Gaussian" not in said


def test_example_of_the_page_on_models_is_one() -> None:
    page = (Path(__file__).parents[2] / "docs/explanation/model.md").read_text()
    example = page.split("```toml", maxsplit=1)[1].split("```", maxsplit=1)[0]
    table = tomllib.loads(example)["sensor"]["noise"]
    assert {"shape_z", "shape_density", "width_spread", "background"} < set(table)
    head = model_text().split("[sensor.noise]", maxsplit=1)[0]
    assert parse_model(head + example, source="model.md").sensor.noise.width_spread == table["width_spread"]


def test_a_curve_keeps_its_parts_at_another_integration_time() -> None:
    curve = NoiseCurve(np.array([1.0]), np.array([2.0]), shape=skewed(), width_spread=0.1, background=np.array(0.2))
    longer = curve.scaled(0.5, amplitude_factor=4.0)
    assert curve.same_as(longer.scaled(2.0))
    assert not curve.same_as(replace(curve, background=None))


LAW = """
amplitude = [50.0, 200.0, 2000.0]
amplitude_factor = [4.0, 2.0, 0.2]
reference_amplitude = [900.0, 700.0, 500.0]
"""
SCENE = """
[[surface]]
name = "dark"
center_mm = [-500.0, 0.0, 1800.0]
size_mm = [800.0, 3000.0]
reflectivity = 0.1
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3000.0]
size_mm = [9000.0, 9000.0]
"""


def model_amplitude(law: str = LAW) -> Model:
    return parse_model(sensor_text(law, outliers=0.0) + SCENE, source="model.toml")


def sigma_by_hand(range_mm: float, amplitude: float) -> float:
    """At 2 ms: amplitudes are a quarter of those at 8 ms, and sigma is twice as large."""
    log_factor = np.interp(np.log(amplitude * 4), np.log([50.0, 200.0, 2000.0]), np.log([4.0, 2.0, 0.2]))
    reference = np.interp(range_mm, [500.0, 2000.0, 5000.0], [900.0, 700.0, 500.0])
    log_reference = np.interp(np.log(reference), np.log([50.0, 200.0, 2000.0]), np.log([4.0, 2.0, 0.2]))
    sigma = 2.0 * np.interp(range_mm, [500.0, 2000.0, 5000.0], [6.0, 15.0, 40.0])
    return float(sigma * np.exp(log_factor - log_reference))


def frames_amplitude(scene: Model, count: int) -> NDArray[np.float64]:
    """Ranges (frame, row, col), mm."""
    blocks = render_blocks(scene, cast_scene(scene), n_frames=count, seed=5)
    return np.concatenate([block.range_mm for block in blocks]).astype(np.float64)


def test_laws_of_amplitude_hold_and_leave_flat_ones_alone() -> None:
    scene = model_amplitude()
    truth, samples = cast_scene(scene), frames_amplitude(scene, 2000)
    whole = [(r, c) for r in range(8) for c in range(12) if truth.n_modes[r, c] == 1]
    assert {int(truth.surface[r, c, 0]) for r, c in whole} == {0, 1}
    for row, col in whole:
        expected = sigma_by_hand(truth.range_true[row, col, 0], truth.amplitude[row, col, 0])
        found = samples[:, row, col].std()
        assert found == pytest.approx(np.hypot(expected, 12**-0.5), rel=4.5 / np.sqrt(2 * 2000))
    flat = LAW.replace("[4.0, 2.0, 0.2]", "[3.0, 3.0, 3.0]")
    np.testing.assert_array_equal(
        frames_amplitude(model_amplitude(flat), 20), frames_amplitude(model_amplitude(law=""), 20)
    )
    scene = replace(model_amplitude(), surfaces=())
    noise = scene.sensor.noise_at(2.0)
    table = event_table(cast_scene(scene), scene.sensor)
    np.testing.assert_array_equal(table.sigma(noise)[-2], noise.sigma(scene.sensor.range_max_mm))


def test_the_prediction_has_the_same_noise() -> None:
    """Mixed pixels included: the probability integral transform of what is drawn is uniform."""
    scene = model_amplitude()
    prediction, samples = predict(scene), frames_amplitude(scene, 500)
    truth = cast_scene(scene)
    np.testing.assert_allclose(
        prediction.sigma_mm[0].reshape(8, 12)[0, 0],
        sigma_by_hand(truth.range_true[0, 0, 0], truth.amplitude[0, 0, 0]),
        rtol=1e-6,
    )
    transform = pit(prediction, samples.reshape(500, -1).astype(np.uint16), np.random.default_rng(3))
    assert stats.kstest(transform.ravel(), "uniform").pvalue > 1e-3
    plain = pit(predict(model_amplitude(law="")), samples.reshape(500, -1).astype(np.uint16), np.random.default_rng(3))
    assert stats.kstest(plain.ravel(), "uniform").pvalue < 1e-9


def test_a_recording_has_the_law_at_its_integration_time() -> None:
    for averaged, tau in ((False, 2.0), (True, 8.5)):
        sensor = recording_sensor(model_amplitude(), averaged=averaged)
        with h5py.File(
            io.BytesIO(hdf5.image_of(partial(sensor_group.write_sensor, sensor=sensor, image=(8, 12)))), "r"
        ) as root:
            group = root["sensor"]
            np.testing.assert_allclose(group["noise_amplitude"], np.array([50.0, 200.0, 2000.0]) * tau / 8)
            np.testing.assert_allclose(group["noise_reference_amplitude"], np.array([900.0, 700.0, 500.0]) * tau / 8)
            np.testing.assert_allclose(group["noise_amplitude_factor"], [4.0, 2.0, 0.2])
            np.testing.assert_allclose(group["noise_sigma"], np.array([6.0, 15.0, 40.0]) * (8 / tau) ** 0.5)


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (
            "amplitude = [1.0]\n",
            "missing reference_amplitude, amplitude_factor; reference_amplitude, amplitude, amplitude_factor go",
        ),
        (LAW.replace("[50.0, ", "["), "2 amplitudes, but 3 factors"),
        (LAW.replace("50.0", "-50.0"), "amplitude must be a list of finite numbers above 0"),
        (LAW.replace("50.0", "500.0"), "its amplitudes do not ascend"),
        (LAW.replace("[900.0, ", "["), "3 ranges, but 2 reference amplitudes"),
        (
            LAW.replace("amplitude = [", "amplitudes = [", 1),
            '"amplitudes" is not a key here; did you mean "amplitude"?',
        ),
    ],
)
def test_impossible_laws_are_refused_in_one_line(law: str, message: str) -> None:
    with pytest.raises(BadInputError, match="^" + re.escape(f"model.toml: [sensor.noise]: {message}")):
        model_amplitude(law)


def test_keys_of_a_model_override_a_law_one_by_one() -> None:
    scene = model_amplitude()
    law = scene.sensor.noise.law
    assert isinstance(law, AmplitudeLaw)
    np.testing.assert_array_equal(law.reference, [900.0, 700.0, 500.0])
    assert scene.sensor.noise.same_as(model_amplitude().sensor.noise)
    assert not scene.sensor.noise.same_as(model_amplitude(law="").sensor.noise)
    assert not scene.sensor.noise.same_as(model_amplitude(LAW.replace("0.2", "0.3")).sensor.noise)


TURN = 299_792_458_000.0 / 20.0e6 / 2.0
FRAMES = 400


@pytest.fixture(scope="module")
def bench() -> Bench:
    """The two scenes."""
    return Bench()


def frames_of_amplitudes(
    model: Model, *, block_frames: int = FRAMES, averaged: bool = False, threads: int = 1
) -> tuple[Floats, ...]:
    """Ranges and amplitudes (frame, pixel)."""
    blocks = list(
        render_blocks(
            model,
            cast_scene(model),
            n_frames=FRAMES,
            seed=3,
            block_frames=block_frames,
            averaged=averaged,
            threads=threads,
        )
    )
    ranges, amplitudes = (np.concatenate([getattr(b, name) for b in blocks]) for name in ("range_mm", "amplitude"))
    return ranges.reshape(FRAMES, -1).astype(np.float64), amplitudes.reshape(FRAMES, -1).astype(np.float64)


@pytest.mark.parametrize(
    ("effects", "light", "noise"),
    [
        ((), 1.0, 1.0),
        ((effect("excess_noise", factor=1.5),), 1.0, 1.5),
        ((effect("multipath", surface="wall", share=0.5, extra_path_mm=2 * TURN),), 1.5, 1.0),
        ((effect("range_offset", offset_mm=500.0),), 1.0, 1.0),
    ],
    ids=["no effect", "excess noise", "more light", "bias"],
)
def test_noise_has_the_standard_deviation_of_the_phasor(
    bench: Bench, effects: tuple[Effect, ...], light: float, noise: float
) -> None:
    recorded = bench.wall(*effects, frames=1)
    expected = recorded.true_amplitude * light
    sigma = recorded.true_amplitude * recorded.sigma(recorded.true_mm) * noise * 2 * math.pi / TURN
    ranges, amplitude = frames_of_amplitudes(recorded.model)
    z = (amplitude - expected) / sigma
    assert abs(z.mean()) < 4 / z.size**0.5
    assert (z**2).mean() == pytest.approx(1, abs=4 * (2 / z.size) ** 0.5)
    of_range = ranges - ranges.mean(axis=0)
    assert abs(np.corrcoef(z.ravel(), (of_range / of_range.std(axis=0)).ravel())[0, 1]) < 4 / z.size**0.5


@pytest.mark.parametrize("averaged", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("effects", [(), (effect("flying_pixels", probability=0.5), effect("dropout", threshold=30.0))])
def test_ranges_are_those_without_noise_in_amplitudes(
    bench: Bench, effects: tuple[Effect, ...], averaged: bool
) -> None:
    base = bench.boards(*effects, frames=1).model
    model = replace(base, sensor=replace(base.sensor, default_integration_time_ms=10.0))
    ranges, amplitude = frames_of_amplitudes(model, averaged=averaged)
    with light_alone():
        plain, light = frames_of_amplitudes(model, averaged=averaged)
    np.testing.assert_array_equal(ranges, plain)
    np.testing.assert_array_equal(amplitude[light == 0], 0)
    assert (amplitude != light)[light > 0].mean() > 0.99


def test_noise_of_amplitudes_has_the_memory_of_ranges_and_needs_a_frequency(bench: Bench) -> None:
    recorded = bench.wall(effect("temporal_correlation", coefficient=0.6), frames=1)
    _, amplitude = frames_of_amplitudes(recorded.model)
    z = (amplitude - recorded.true_amplitude) / recorded.true_amplitude
    assert np.mean(z[1:] * z[:-1]) / np.mean(z**2) == pytest.approx(0.6, abs=0.02)
    # Noise of two thirds of the amplitude: 7 % would be below 0.
    recorded = bench.wall(effect("excess_noise", factor=20.0), frames=1)
    _, amplitude = frames_of_amplitudes(recorded.model)
    assert amplitude.min() == 0
    for effects in ((), (effect("excess_noise", factor=2.0),)):
        recorded = bench.wall(*effects, frames=1, modulation_frequency_hz=None)
        _, amplitude = frames_of_amplitudes(recorded.model)
        np.testing.assert_array_equal(amplitude, np.broadcast_to(recorded.true_amplitude, amplitude.shape))
