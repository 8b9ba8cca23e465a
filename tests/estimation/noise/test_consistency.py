"""What samples say against their noise curve before an estimate: their scatter, and their drift."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tofmix.estimation.noise.curve_check import Consistency, check_consistency
from tofmix.recording import ArrayRecording, SampleSource
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor

SIGMA_MM = 20.0
CURVE = NoiseCurve(np.array([500.0, 5000.0]), np.array([SIGMA_MM, SIGMA_MM]))
CAMERA = Sensor(name="test", range_min_mm=100.0, range_max_mm=6000.0, noise=CURVE)


def _recording(
    rng: np.random.Generator, *, factor: float = 1.0, drift: float = 0.0, frames: int = 60, step: float = 0.0
) -> ArrayRecording:
    """A wall over 12 x 16 pixels; noise and drift in sigmas, drift over all frames."""
    wall = np.linspace(1000.0, 2000.0, 12 * 16).reshape(12, 16)
    noise = rng.normal(0.0, factor * SIGMA_MM, (frames, 12, 16))
    moved = drift * SIGMA_MM * np.arange(frames)[:, None, None] / frames
    samples = wall + noise + moved
    return ArrayRecording(np.rint(samples / step) * step if step else samples, CAMERA)


def _check(source: SampleSource, window: int | None = None, curve: NoiseCurve = CURVE) -> Consistency:
    return check_consistency(source, curve, window_frames=window or source.shape[0])


@pytest.mark.parametrize("factor", [0.05, 0.5, 1.0, 3.0])
def test_scatter_is_that_of_the_samples(rng: np.random.Generator, factor: float) -> None:
    found = _check(_recording(rng, factor=factor))
    assert found.scatter_over_curve == pytest.approx(factor, rel=0.03)
    assert found.pixels > 120
    assert found.drift_sigmas is not None
    assert found.drift_sigmas < 0.4


@pytest.mark.parametrize("drift", [2.0, 8.0])
@pytest.mark.parametrize(
    ("frames", "window"),
    [(60, 60), (330, 150), *(pytest.param(*n, marks=pytest.mark.slow) for n in ((60, 20), (330, 330), (1000, 1000)))],
)
def test_drift_is_that_within_a_window(rng: np.random.Generator, drift: float, frames: int, window: int) -> None:
    """A drift of so many sigmas within each window, whatever the recording's length."""
    found = _check(_recording(rng, drift=drift * frames / window, frames=frames), window)
    assert found.drift_sigmas == pytest.approx(drift, rel=0.2)
    assert found.scatter_over_curve == pytest.approx(1.0, rel=0.03)  # the trend is taken out


def test_few_pixels_of_two_surfaces_do_not_change_the_scatter(rng: np.random.Generator) -> None:
    samples = _recording(rng).read_range(slice(None), slice(None)).copy()
    there = rng.random((60, 12, 5)) < 0.5
    samples[:, :, :5] += np.where(there, 800.0, 0.0)
    assert _check(ArrayRecording(samples, CAMERA)).scatter_over_curve == pytest.approx(1.0, rel=0.03)


def test_pixels_without_a_return_are_not_judged(rng: np.random.Generator) -> None:
    """Most of the image returns the constant of an empty sky."""
    samples = _recording(rng).read_range(slice(None), slice(None)).copy()
    samples[:, 4:] = 6000.0
    assert _check(ArrayRecording(samples, CAMERA)).scatter_over_curve == pytest.approx(1.0, rel=0.05)


@pytest.mark.slow
def test_rounding_is_no_scatter_and_hides_none(rng: np.random.Generator) -> None:
    assert _check(_recording(rng, step=30.0)).scatter_over_curve == pytest.approx(1.0, rel=0.05)
    assert _check(_recording(rng, step=100.0)).scatter_over_curve is None


def test_constant_samples_have_no_scatter() -> None:
    found = _check(ArrayRecording(np.full((30, 12, 16), 1500.0), CAMERA))
    assert found.scatter_over_curve == 0.0


def test_too_few_frames_or_pixels_give_no_result(rng: np.random.Generator) -> None:
    for source in (_recording(rng, frames=9), ArrayRecording(rng.normal(1500, 20, (50, 4, 5)), CAMERA)):
        found = _check(source)
        assert (found.pixels, found.scatter_over_curve, found.drift_sigmas) == (0, None, None)
    assert check_consistency(_recording(rng), None, window_frames=60).pixels == 0
    assert _check(_recording(rng), 9).drift_sigmas is None


def test_a_law_of_amplitude_is_followed(rng: np.random.Generator) -> None:
    amplitude = np.broadcast_to(np.geomspace(50.0, 800.0, 16), (60, 12, 16))
    samples = 1500.0 + rng.normal(0.0, 1.0, amplitude.shape) * SIGMA_MM * (200.0 / amplitude)
    law = AmplitudeLaw(np.full(2, 200.0), np.array([50.0, 800.0]), np.array([16.0, 1.0]))
    curve = replace(CURVE, law=law)
    found = _check(ArrayRecording(samples, CAMERA, amplitude), curve=curve)
    assert found.scatter_over_curve == pytest.approx(1.0, rel=0.05)


def test_on_a_circle_the_fold_is_no_scatter(rng: np.random.Generator) -> None:
    folded = np.mod(rng.normal(3000.0, SIGMA_MM, (60, 12, 16)), 3000.0)
    source = ArrayRecording(folded, CAMERA)
    found = check_consistency(source, CURVE, window_frames=60, unambiguous_range_mm=3000.0)
    assert found.scatter_over_curve == pytest.approx(1.0, rel=0.05)
    assert found.drift_sigmas is not None
    assert found.drift_sigmas < 0.4


class Targets(ArrayRecording):
    """Two targets a frame, which follow each other."""

    targets = 2


@pytest.mark.parametrize("circle", [None, 3000.0])
def test_targets_of_a_frame_are_series_of_their_own(rng: np.random.Generator, circle: float | None) -> None:
    near, far = (wall + rng.normal(0.0, SIGMA_MM, (60, 12, 16)) for wall in (1500.0, 2500.0))
    source = Targets(np.stack([near, far], axis=1).reshape(120, 12, 16), CAMERA)
    found = check_consistency(source, CURVE, window_frames=60, unambiguous_range_mm=circle)
    assert found.pixels > 240
    assert found.scatter_over_curve == pytest.approx(1.0, rel=0.05)
    assert found.drift_sigmas is not None
    assert found.drift_sigmas < 0.4


def test_of_a_large_image_a_part_is_read(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = np.broadcast_to(rng.normal(1500.0, SIGMA_MM, (12, 1, 1)), (12, 200, 300))
    source = ArrayRecording(samples, CAMERA)
    read: list[int] = []
    inner = ArrayRecording.read_range

    def counting(self: ArrayRecording, frames: slice, rows: slice) -> np.ndarray:
        block = inner(self, frames, rows)
        read.append(block[0].size)
        return block

    monkeypatch.setattr(ArrayRecording, "read_range", counting)
    _check(source)
    assert sum(read) <= 1 << 13


@pytest.mark.parametrize("window", [40, 240])
def test_of_many_pixels_some_are_judged_over_the_whole_window(rng: np.random.Generator, window: int) -> None:
    """The lower half drifts by 4 sigma within a window, of one run of frames or of two."""
    moved = np.where(np.arange(50)[:, None] >= 25, 4.0, 0.0) * np.arange(window)[:, None, None] / window
    samples = 1500.0 + SIGMA_MM * (moved + rng.standard_normal((window, 50, 60)))
    found = _check(ArrayRecording(samples, CAMERA))
    assert 0.4 * 2048 < found.pixels <= 2048
    assert found.scatter_over_curve == pytest.approx(1.0, rel=0.03)
    assert found.drift_sigmas == pytest.approx(4.0, rel=0.2)  # that of a quarter of the pixels or more


def test_the_sample_recording_drifts() -> None:
    """sample_data/README.md: a near object drifts; the README's first command says so."""
    from tofmix.io.recording.recording_file import open_recording

    with open_recording(Path(__file__).parents[3] / "sample_data" / "tmf8829_edge.h5") as recording:
        found = _check(recording, curve=recording.sensor.noise or CURVE)
    assert found.drift_sigmas is not None
    assert 2.5 < found.drift_sigmas < 4.0
