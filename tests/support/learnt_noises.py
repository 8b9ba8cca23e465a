"""A camera with learnt noise in every part, and samples of its pixels made without the package's simulator."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from support.files import write_recording
from support.noise_parts import skewed
from tofmix.arrays import FloatArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.learnt.folds import flat_thresholds
from tofmix.grid import plan_windows
from tofmix.io.layers.layers_file import LayersWriter
from tofmix.io.recording.recording_file import file_sha256
from tofmix.layers import Layers, Provenance
from tofmix.noise_shape import LearntNoise, NoiseShape
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor

SPAN_MM = (300.0, 5300.0)
SIGMA_MM = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """The parts of a noise: None and 0 where there is none."""

    shape: NoiseShape | None = None
    width_spread: float = 0.0
    background: float = 0.0
    drift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    memory: float = 0.0


ALL = Parts(shape=skewed(1.0), width_spread=0.2, background=0.15, drift_mm=(40.0, 10.0, 5.0), memory=0.1)


def camera(parts: Parts, image: tuple[int, int]) -> Sensor:
    """A camera of one sigma with these parts; the gains of chance are those of `flat_thresholds`."""
    flat = flat_thresholds()
    background = np.full(image, parts.background) if parts.background else None
    curve = NoiseCurve(
        np.array([500.0, 5000.0]),
        np.array([SIGMA_MM, SIGMA_MM]),
        shape=parts.shape,
        width_spread=parts.width_spread,
        background=background,
    )
    learnt = LearntNoise(
        background=(20.0 * parts.background, 20.0 * (1.0 - parts.background)) if parts.background else None,
        drift_mm=np.array(parts.drift_mm),
        memory=parts.memory,
        gain_samples=np.exp(flat.log_n),
        gain_background=flat.background,
        gain_more=flat.more,
        gain_first=flat.first,
    )
    return Sensor(name="camera", range_min_mm=SPAN_MM[0], range_max_mm=SPAN_MM[1], noise=curve, learnt=learnt)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Made:
    """Samples (frame, row, col), mm, of a plane that each pixel sees at `range_mm` (row, col), and the truth."""

    sensor: Sensor
    samples_mm: FloatArray
    range_mm: FloatArray
    width: FloatArray
    drift_mm: FloatArray

    def layers(self) -> Layers:
        """What the estimator finds, of the leading shape (row, col)."""
        found = estimate_layers(ArrayRecording(self.samples_mm.astype(np.float32), self.sensor))
        return found.reshaped(found.shape[1:])

    def provenance(self) -> Provenance:
        """As of a layers file."""
        return Provenance(source="a.h5", source_sha256="ab" * 32, version="1", sensor=self.sensor)


def made(parts: Parts, *, frames: int, image: tuple[int, int], seed: int = 1) -> Made:
    """Samples of pixels with this noise."""
    rng = np.random.default_rng(seed)
    range_mm = np.linspace(1500.0, 3000.0, image[0] * image[1]).reshape(image)
    width = np.exp(parts.width_spread * rng.standard_normal(image))
    drift_mm = rng.standard_normal((3, *image)) * np.array(parts.drift_mm)[:, None, None]
    time = np.linspace(-1.0, 1.0, frames)
    polynomials = np.array([time, 1.5 * time**2 - 0.5, 2.5 * time**3 - 1.5 * time])
    size = (frames, *image)
    errors = rng.standard_normal(size) if parts.shape is None else parts.shape.quantile(rng.random(size))
    samples = range_mm + np.einsum("dt,drc->trc", polynomials, drift_mm) + SIGMA_MM * width * errors
    random = rng.random(size) < parts.background
    samples[random] = rng.uniform(*SPAN_MM, int(random.sum()))
    return Made(sensor=camera(parts, image), samples_mm=samples, range_mm=range_mm, width=width, drift_mm=drift_mm)


def write_files(folder: Path, case: Made) -> tuple[Path, Path]:
    """A recording without a noise curve, and its layers file as `tofmix estimate --noise auto` writes it."""
    frames, rows, cols = case.samples_mm.shape
    recording = write_recording(
        folder / "a.h5",
        case.samples_mm.astype("f4"),
        noise=None,
        attributes={"range_min_mm": SPAN_MM[0], "range_max_mm": SPAN_MM[1]},
    )
    layers = case.layers()
    path = folder / "a.layers.h5"
    made_from = replace(case.provenance(), source_sha256=file_sha256(recording))
    with LayersWriter(
        path,
        windows=plan_windows(frames, window=frames),
        image=(rows, cols),
        max_layers=layers.max_layers,
        tile=(1, rows),
        provenance=made_from,
    ) as writer:
        writer.write(slice(0, 1), slice(0, rows), layers.reshaped((1, rows, cols)))
    return recording, path
