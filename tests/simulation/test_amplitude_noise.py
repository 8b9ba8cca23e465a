"""A model whose noise depends on amplitude: its keys, what is drawn, what is predicted, and what a recording says."""

import io
import re
from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from support.noise_parts import sensor_text
from support.transform import pit

from tofmix.errors import BadInputError
from tofmix.io import hdf5, sensor_group
from tofmix.sensor import AmplitudeLaw
from tofmix.simulation.averaging import exposures
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import event_table
from tofmix.simulation.exposure import predict
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.render import recording_sensor, render_blocks

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


def model(law: str = LAW) -> Model:
    return parse_model(sensor_text(law, outliers=0.0) + SCENE, source="model.toml")


def sigma_by_hand(range_mm: float, amplitude: float) -> float:
    """At 2 ms: amplitudes are a quarter of those at 8 ms, and sigma is twice as large."""
    log_factor = np.interp(np.log(amplitude * 4), np.log([50.0, 200.0, 2000.0]), np.log([4.0, 2.0, 0.2]))
    reference = np.interp(range_mm, [500.0, 2000.0, 5000.0], [900.0, 700.0, 500.0])
    log_reference = np.interp(np.log(reference), np.log([50.0, 200.0, 2000.0]), np.log([4.0, 2.0, 0.2]))
    sigma = 2.0 * np.interp(range_mm, [500.0, 2000.0, 5000.0], [6.0, 15.0, 40.0])
    return float(sigma * np.exp(log_factor - log_reference))


def frames(scene: Model, count: int) -> NDArray[np.float64]:
    """Ranges (frame, row, col), mm."""
    blocks = render_blocks(scene, cast_scene(scene), n_frames=count, seed=5)
    return np.concatenate([block.range_mm for block in blocks]).astype(np.float64)


def test_samples_scatter_as_their_amplitude_says() -> None:
    scene = model()
    truth, samples = cast_scene(scene), frames(scene, 2000)
    whole = [(r, c) for r in range(8) for c in range(12) if truth.n_modes[r, c] == 1]
    assert {int(truth.surface[r, c, 0]) for r, c in whole} == {0, 1}
    for row, col in whole:
        expected = sigma_by_hand(truth.range_true[row, col, 0], truth.amplitude[row, col, 0])
        found = samples[:, row, col].std()
        assert found == pytest.approx(np.hypot(expected, 12**-0.5), rel=4.5 / np.sqrt(2 * 2000))


def test_the_prediction_has_the_same_noise() -> None:
    """Mixed pixels included: the probability integral transform of what is drawn is uniform."""
    scene = model()
    prediction, samples = predict(scene), frames(scene, 500)
    truth = cast_scene(scene)
    np.testing.assert_allclose(
        prediction.sigma_mm[0].reshape(8, 12)[0, 0],
        sigma_by_hand(truth.range_true[0, 0, 0], truth.amplitude[0, 0, 0]),
        rtol=1e-6,
    )
    transform = pit(prediction, samples.reshape(500, -1).astype(np.uint16), np.random.default_rng(3))
    assert stats.kstest(transform.ravel(), "uniform").pvalue > 1e-3
    plain = pit(predict(model(law="")), samples.reshape(500, -1).astype(np.uint16), np.random.default_rng(3))
    assert stats.kstest(plain.ravel(), "uniform").pvalue < 1e-9


def test_law_without_effect_changes_no_sample() -> None:
    flat = LAW.replace("[4.0, 2.0, 0.2]", "[3.0, 3.0, 3.0]")
    np.testing.assert_array_equal(frames(model(flat), 20), frames(model(law=""), 20))


def test_a_sample_without_a_return_has_the_curves_noise() -> None:
    scene = replace(model(), surfaces=())
    noise = scene.sensor.noise_at(2.0)
    table = event_table(cast_scene(scene), scene.sensor)
    np.testing.assert_array_equal(table.sigma(noise)[-2], noise.sigma(scene.sensor.range_max_mm))


def test_parts_of_an_averaged_frame_have_the_noise_of_their_own_time() -> None:
    """The last 0.5 ms of 8.5: a quarter of the amplitude, and of those of the law, so that sigma is twice as large."""
    scene = model()
    table = event_table(cast_scene(scene), scene.sensor)
    parts = exposures(table, scene.sensor)
    assert [part.fraction for part in parts] == [1.0] * 4 + [pytest.approx(0.25)]
    np.testing.assert_allclose(parts[-1].sigma_mm, 2.0 * parts[0].sigma_mm, rtol=1e-6)


def test_a_recording_has_the_law_at_its_integration_time() -> None:
    for averaged, tau in ((False, 2.0), (True, 8.5)):
        sensor = recording_sensor(model(), averaged=averaged)
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
        ("amplitude = [1.0]\n", "missing reference_amplitude; reference_amplitude, amplitude, amplitude_factor go"),
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
        model(law)


def test_keys_of_a_model_override_a_law_one_by_one() -> None:
    scene = model()
    law = scene.sensor.noise.law
    assert isinstance(law, AmplitudeLaw)
    np.testing.assert_array_equal(law.reference, [900.0, 700.0, 500.0])
    assert scene.sensor.noise.same_as(model().sensor.noise)
    assert not scene.sensor.noise.same_as(model(law="").sensor.noise)
    assert not scene.sensor.noise.same_as(model(LAW.replace("0.2", "0.3")).sensor.noise)
