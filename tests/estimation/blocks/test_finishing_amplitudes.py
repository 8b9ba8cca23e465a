"""Mean amplitudes of layers, against a loop over samples; and the share of lost frames."""

import numpy as np
import pytest

from tofmix.estimation.blocks.finishing import layer_amplitudes
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.samples import invalid_share
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor

CAMERA = Sensor(name="a", range_min_mm=100.0, range_max_mm=6000.0, noise=NoiseCurve(np.array([1e3]), np.array([10.0])))


def two_surfaces(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Samples (frame, row, col) and amplitudes of a near bright and a far dark surface; a tenth is lost."""
    rng = np.random.default_rng(seed)
    near = rng.random((60, 3, 4)) < 0.5
    samples = np.where(near, 1000.0, 3000.0) + 10.0 * rng.standard_normal(near.shape)
    light = np.where(near, 400.0, 50.0) + rng.standard_normal(near.shape)
    samples[rng.random(near.shape) < 0.1] = np.nan
    samples[0, 0, 0], light[0, 0, 0] = 5000.0, 1e6  # of no layer
    light[1, 1, 1] = np.nan
    return samples.astype(np.float32), light.astype(np.float32)


def test_amplitudes_of_two_surfaces_are_the_means_of_their_samples() -> None:
    samples, light = two_surfaces()
    layers = layer_pixels(samples, CAMERA)
    found = layer_amplitudes(samples, light, layers)
    assert (layers.n_modes == 2).all()
    for row, col in np.ndindex(3, 4):
        for layer, place in enumerate((1000.0, 3000.0)):
            of_layer = np.abs(samples[:, row, col] - place) < 60.0
            assert found[row, col, layer] == pytest.approx(np.nanmean(light[of_layer, row, col]), rel=1e-6)
    assert np.isnan(found[..., 2:]).all()


def test_sample_across_the_fold_is_of_its_layer() -> None:
    samples = np.array([[2.0], [4998.0], [1.0], [4999.0]], np.float32)
    layers = layer_pixels(samples[:1].repeat(4, axis=0), CAMERA)
    assert layer_amplitudes(samples, np.array([[1.0], [2], [3], [4]]), layers)[0, 0] == pytest.approx(2.0)
    assert layer_amplitudes(samples, np.array([[1.0], [2], [3], [4]]), layers, circle_mm=5e3)[0, 0] == pytest.approx(
        2.5
    )


def test_estimate_has_amplitudes_only_of_recordings_with_amplitudes() -> None:
    samples, light = two_surfaces()
    with_light, without = (estimate_layers(ArrayRecording(samples, CAMERA, *more)) for more in ((light,), ()))
    assert without.amplitude is None
    assert with_light.amplitude is not None
    np.testing.assert_allclose(with_light.amplitude[0, 2, 2, :2], [400.0, 50.0], rtol=0.02)
    assert with_light.probability.tobytes() == without.probability.tobytes()


def test_invalid_share_is_that_of_frames_without_any_valid_target() -> None:
    samples = np.array([[1.0, np.nan], [np.nan, np.nan], [2.0, 3.0], [4.0, 2e9], [np.nan, np.inf], [np.nan, 1.0]])
    np.testing.assert_allclose(invalid_share(samples), [0.5, 4 / 6], rtol=1e-6)
    np.testing.assert_allclose(invalid_share(samples, samples_a_frame=2), [1 / 3, 1 / 3], rtol=1e-6)


def test_frames_that_add_no_sample_behind_a_filter_are_not_lost() -> None:
    samples = np.array([[1.0, np.nan], [np.inf, np.inf], [np.inf, 3.0], [4.0, 2e9]])
    np.testing.assert_allclose(invalid_share(samples, is_filtered=True), [0.0, 2 / 3], rtol=1e-6)


def test_estimate_gives_the_share_of_lost_samples_and_weighs_layers_by_it() -> None:
    rng = np.random.default_rng(3)
    samples = 2000.0 + 10.0 * rng.standard_normal((100, 12, 12))
    lost = np.zeros(samples.shape, bool)
    lost[:, 4:8, 4:8] = rng.random((100, 4, 4)) < 0.92
    found = estimate_layers(ArrayRecording(np.where(lost, np.nan, samples), CAMERA))
    assert found.invalid_share is not None
    np.testing.assert_allclose(found.invalid_share[0], lost.mean(axis=0), atol=1e-6)
    dark = lost.any(axis=0) & (found.n_modes[0] > 0)
    assert found.probability[0, dark, 0].max() < 0.3
    assert (found.probability[0, ~lost.any(axis=0), 0] == 1.0).all()
