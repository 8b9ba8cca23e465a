"""Description of a simulation in words, effect by effect, for ``simulate --explain``."""

import math
from collections.abc import Iterator

from tofmix.optics.ranging import unambiguous_range_mm
from tofmix.simulation.effects.base import LEVEL_NAMES, Level
from tofmix.simulation.model import Model
from tofmix.wording import counted


def explain(model: Model) -> str:
    """The model in words, one fact a line, without a newline at the end."""
    return "\n".join([*_camera(model), *_scene(model), *_samples(model), *_effects(model)])


def _camera(model: Model) -> Iterator[str]:
    sensor, recording = model.sensor, model.recording
    yield (
        f"camera: {sensor.name}, {sensor.rows} x {sensor.cols} pixels over {sensor.optics.words(sensor.shape)}, "
        f"{sensor.range_min_mm:g} to {sensor.range_max_mm:g} mm"
    )
    frequency = sensor.modulation_frequency_hz
    if frequency is None:
        yield f"light: no phase is measured; {sensor.integration_time_ms:g} ms a sample"
    else:
        yield (
            f"light: {frequency / 1e6:g} MHz, the phase turns once in {unambiguous_range_mm(frequency):.0f} mm; "
            f"{sensor.integration_time_ms:g} ms a sample"
        )
    middle = math.sqrt(max(sensor.range_min_mm, 1.0) * sensor.range_max_mm)
    sigma = float(sensor.noise_at(sensor.integration_time_ms).sigma(middle))
    law = "" if sensor.noise.law is None else "; less where a sample is bright, more where it is faint"
    kind = (
        "Gaussian"
        if sensor.noise.shape is None
        else f"of its own shape, skewness {sensor.noise.shape.moments()[2]:.2g}"
    )
    yield f"noise: {kind}, sigma(r) of the camera, such as {sigma:.3g} mm at {middle:.0f} mm{law}"
    if sensor.noise.width_spread:
        spread = f"{sensor.noise.width_spread:g}"
        yield f"widths: each pixel has a factor on its noise, of median 1, with a spread of its logarithm of {spread}"
    if sensor.noise.background is not None:
        low, high = 100 * float(sensor.noise.background.min()), 100 * float(sensor.noise.background.max())
        share = f"{low:.3g} %" if low == high else f"{low:.3g} to {high:.3g} %, by pixel,"
        yield f"background: {share} of the samples are random values, in addition to outlier_probability"
    yield (
        f"recording: {counted(recording.frames, 'frame')} at {recording.frame_rate_hz:g} Hz, "
        f"{recording.frames / recording.frame_rate_hz:g} s in all, seed {recording.seed}"
    )


def _scene(model: Model) -> Iterator[str]:
    names = ", ".join(f'"{surface.name}"' for surface in model.surfaces)
    yield (
        f"scene: {counted(len(model.surfaces), 'surface')}: {names}"
        if names
        else "scene: no surface, no return anywhere"
    )


def _samples(model: Model) -> Iterator[str]:
    yield (
        "samples: each sample shows one surface with its share of the pixel's beam, no return around "
        f"{model.sensor.range_max_mm:g} mm, or, with probability {model.sensor.outlier_probability:g}, a random value"
    )


def _effects(model: Model) -> Iterator[str]:
    if not model.effects:
        yield "effects: none; samples are drawn from equation (1)"
        return
    yield "effects, in the order in which they act:"
    for effect in model.acting():
        yield f"  {LEVEL_NAMES[Level(effect.level)]}: {effect.kind}: {effect.explain()}"
