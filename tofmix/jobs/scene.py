"""Write what a recording saw as a model: pixel by pixel, or each plane of its surfaces as a rectangle.

`write_measured` writes a model whose scene is a layers file. `write_scene` writes rectangles, with the camera and its
noise: `scene_of_file` takes a recording, a layers file or a surfaces file, `scene_of_layers` what is in memory.
"""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.estimation.settings import EstimateOptions
from tofmix.io.hdf5 import format_of
from tofmix.io.layers.layers_file import FORMAT as LAYERS
from tofmix.io.layers.layers_file import LayersFile, open_layers
from tofmix.io.model_file import scene_of_window
from tofmix.io.next_command import next_command
from tofmix.io.recording.recording_file import RecordingFile
from tofmix.io.storage import locked, write_atomic_group
from tofmix.io.surfaces_file import FORMAT as SURFACES
from tofmix.io.surfaces_file import open_surfaces
from tofmix.jobs.estimate import About, EstimateRequest, FileRequest, estimate_file
from tofmix.jobs.files import check_view, check_window, opened_recording
from tofmix.jobs.reporter import OptionError, Reporter
from tofmix.layers import Layers, LayersSource
from tofmix.noise_shape import WHOLE_MM
from tofmix.optics.projection import Projection, beam_directions_of
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.sensor_schema import ShareLaw
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.quantisation import Quantisation
from tofmix.simulation.effects.temporal_correlation import TemporalCorrelation
from tofmix.simulation.measured_scene import SceneTable, camera_of
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.model_toml import BACKGROUND_MAP, model_text, parse_model, scene_text
from tofmix.simulation.surface import USUAL_REFLECTIVITY, Surface, surface_along
from tofmix.surfaces.found import WindowSurfaces
from tofmix.surfaces.reconstruct import reconstruct
from tofmix.surfaces.rectangles import outline_rectangle
from tofmix.version import __version__
from tofmix.wording import counted

CHANGED = 0.1
"""Change of a surface's share, in parts of the pixel, from which on a pixel is counted: the fine image, in 8 x 8 parts,
has a straight edge to a sixteenth of a pixel."""

_MEMORY_BYTES = 10**9  # of the estimate of a recording, the default of `tofmix estimate`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneScene:
    """A model that was made of surfaces.

    Parameters
    ----------
    model : Model
        The model, with its text.
    background : (row, col) float32 or None
        The map of background shares that the text names.
    values : dict
        Counts, for JSON: `surfaces` that were written, `smooth_surfaces`, `hidden_surfaces` and
        `covering_surfaces` that were not, `pixels`, `pixels_changed`, `suspect_left_out`, `window`, and `notes`.
    """

    model: Model
    background: Float32Array | None
    values: dict[str, Any]

    @property
    def words(self) -> str:
        """The counts in words."""
        counts = self.values
        smooth, hidden, covering = (counts[f"{kind}_surfaces"] for kind in ("smooth", "hidden", "covering"))
        suspect = counts["suspect_left_out"]
        parts = [counted(counts["surfaces"], "surface", ",")]
        parts += [f"{counted(smooth, 'smooth surface', ',')} left out, no plane"] if smooth else []
        parts += [f"{counted(hidden, 'surface', ',')} left out, nowhere the nearest"] if hidden else []
        parts += [f"{covering:,} left out, of which a rectangle covers more of others"] if covering else []
        parts += [f"{counted(suspect, 'suspect layer', ',')} left out"] if suspect else []
        changed = f"{counts['pixels_changed']:,} of {counted(counts['pixels'], 'pixel', ',')}"
        parts.append(f"a share changes by more than {CHANGED:g} in {changed}")
        return "; ".join(parts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Surfaces of one window, numbered by `numbers`, with their layers if these are at hand."""

    found: WindowSurfaces
    numbers: IntArray
    sensor: Sensor
    layers: Layers | None
    source: str
    window: int
    recording: RecordingSettings

    @property
    def optics(self) -> Projection:
        optics = self.sensor.optics
        if optics is None:
            raise BadInputError(f"{self.source}: sensor: no field of view, so surfaces cannot be placed in space")
        return optics

    @property
    def shape(self) -> tuple[int, int]:
        rows, cols, _ = self.found.surface.shape
        return rows, cols


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredModel:
    """A model whose scene is a layers file.

    Parameters
    ----------
    text : str
        The model file.
    layers : bytes
        The layers file.
    values : dict
        Counts, for JSON: `surfaces`, `layers`, `layers_of_no_surface`, `pixels`, `pixels_unknown`, `window`, `notes`.
    """

    text: str
    layers: bytes
    values: dict[str, Any]

    @property
    def words(self) -> str:
        """The counts in words."""
        counts = self.values
        parts = [f"{counted(counts['layers'], 'layer', ',')} of {counted(counts['surfaces'], 'surface', ',')}"]
        free, unknown = counts["layers_of_no_surface"], counts["pixels_unknown"]
        parts += [f"{free:,} of no surface"] if free else []
        parts += [f"{unknown:,} of {counted(counts['pixels'], 'pixel', ',')} with too few samples"] if unknown else []
        return "; ".join(parts)


def write_measured(
    source: Path, output: Path, reporter: Reporter, *, window: int, workers: int, overwrite: bool
) -> MeasuredModel:
    """Write a model whose scene is what a recording, or the window of a layers file, saw; its layers go beside it.

    Raises
    ------
    BadInputError
        If the file cannot be read, is a surfaces file, or the directions of its pixels or its noise are not known.
    OptionError
        If there is no such window.
    """
    path = output.with_name(f"{output.stem}.layers.h5")
    with locked(output, overwrite=overwrite, inputs=(source,)):
        made = measured_of_file(source, reporter, path.name, window=window, workers=workers)
        write_atomic_group({path: made.layers, output: made.text.encode()}, overwrite=overwrite, inputs=(source,))
    return made


def measured_of_file(
    source: Path, reporter: Reporter, layers_path: str, *, window: int = 0, workers: int = 1
) -> MeasuredModel:
    """The model of what a file saw, which names its layers `layers_path`; refusals as of `write_measured`."""
    kind = format_of(source)
    if kind == SURFACES:
        raise BadInputError(
            f"{source}: a surfaces file has no widths and no shares of samples; give the layers file that it was made"
            " from, or --planes"
        )
    if kind == LAYERS:
        with open_layers(source) as layers:
            check_window(layers, window, reporter)
            if layers.shape[1:] != (1, 1):
                check_view(layers)
            return measured_model(layers, source, reporter, layers_path, window=window)[0]
    if window:
        raise OptionError(f"{reporter.option('window')} {window}: {source} is a recording, which is one window here")
    with opened_recording(source, reporter) as recording:
        if recording.shape[1:] != (1, 1):
            _check_recorded_view(recording)
        settings, (_, rows, cols) = settings_of(recording), recording.shape
    with reporter.steps(rows * cols, "estimate", "px"), estimated(source, workers, reporter) as layers:
        return measured_model(layers, source, reporter, layers_path, settings=settings)[0]


def measured_model(
    layers: LayersFile,
    source: Path,
    reporter: Reporter,
    layers_path: str,
    *,
    window: int = 0,
    settings: RecordingSettings | None = None,
    table: SceneTable | None = None,
) -> tuple[MeasuredModel, Model]:
    """The model of the layers of a window: its files, and the model itself.

    Parameters
    ----------
    layers : LayersFile
        The layers.
    source : Path
        What they were made from, for messages and the remark at the head of the text.
    reporter : Reporter
        Receives notes.
    layers_path : str
        By which the text names the layers.
    window : int
        Number of the window.
    settings : RecordingSettings, optional
        Of the recording; without it the frames of the window, at the default rate.
    table : SceneTable, optional
        What the model says of these layers; its paths are not used.

    Raises
    ------
    BadInputError
        If the directions of pixels or the noise are not known, or no pixel has a layer.
    """
    sensor = layers.provenance.sensor
    try:
        parts = scene_of_window(layers, window, replace(table or SceneTable(), layers_path=layers_path))
        camera, scene = parts
        longest = float(np.nanmax(scene.range_mm))
        _, assumed = camera_of(sensor, camera.shape, longest_mm=longest, others_mm=scene.range_max_mm)
    except (ValueError, BadInputError) as error:
        raise BadInputError(f"{source}: window {window}: {error}") from error
    notes = [note.replace("is written", "is used").replace("are written", "are used") for note in assumed]
    notes += _not_written(sensor)
    for note in notes:
        reporter.note(f"{source}: {note}")
    text = scene_text(
        scene,
        settings or recording_settings(scene.frames, None),
        _effects(sensor),
        window=window,
        remarks=[f"what {source.name} saw: written by tofmix {__version__}", *notes],
    )
    values = {
        "window": window,
        "surfaces": len(scene.surfaces),
        "layers": int((scene.surface >= 0).sum()),
        "layers_of_no_surface": int((scene.surface == len(scene.surfaces)).sum()),
        "pixels": int(scene.known.size),
        "pixels_unknown": int((~scene.known).sum()),
        "notes": notes,
    }
    model = parse_model(text, source=str(source), read_scene=lambda _table: parts)
    return MeasuredModel(text=text, layers=layers.path.read_bytes(), values=values), model


def write_scene(
    source: Path, output: Path, reporter: Reporter, *, window: int, workers: int, overwrite: bool
) -> PlaneScene:
    """Write the model of a recording, a layers file or a surfaces file; a map of background shares goes beside it."""
    path = output.with_name(f"{output.stem}.background.npy")
    with locked(output, overwrite=overwrite, inputs=(source,)):
        scene = scene_of_file(source, reporter, window=window, workers=workers, background=path.name)
        contents: dict[Path, bytes] = {}
        if scene.background is not None:
            buffer = io.BytesIO()
            np.save(buffer, scene.background, allow_pickle=False)
            contents[path] = buffer.getvalue()
        contents[output] = scene.model.text.encode()
        write_atomic_group(contents, overwrite=overwrite, inputs=(source,))
    return scene


def scene_of_file(
    source: Path, reporter: Reporter, *, window: int, workers: int, background: str = BACKGROUND_MAP
) -> PlaneScene:
    """The model of a file.

    Parameters
    ----------
    source : Path
        A recording, which is estimated as `tofmix estimate` does; a layers file, whose surfaces are found as
        `tofmix surfaces` does; or a surfaces file.
    window : int
        Number of the window; a recording is one window.
    workers : int
        Threads of an estimate.
    background : str
        Path by which the text names the map of background shares.

    Raises
    ------
    BadInputError
        If the file cannot be read, the directions of its pixels or its noise are not known, or it shows no plane.
    OptionError
        If there is no such window.
    """
    kind = format_of(source)
    if kind == SURFACES:
        with open_surfaces(source) as file:
            check_window(file, window, reporter)
            seen = _Seen(
                found=file.read_window(window),
                numbers=np.flatnonzero(file.surface_window == window),
                sensor=file.provenance.sensor,
                layers=None,
                source=str(source),
                window=window,
                recording=RecordingSettings(),
            )
            return _scene(seen, reporter, background)
    if kind == LAYERS:
        with open_layers(source) as layers:
            check_window(layers, window, reporter)
            return scene_of_layers(layers, str(source), reporter, window=window, background=background)
    if window:
        raise OptionError(f"{reporter.option('window')} {window}: {source} is a recording, which is one window here")
    with opened_recording(source, reporter) as recording:
        _check_recorded_view(recording)
        settings, (_, rows, cols) = settings_of(recording), recording.shape
    with reporter.steps(rows * cols, "estimate", "px"), estimated(source, workers, reporter) as layers:
        return scene_of_layers(layers, str(source), reporter, window=0, recording=settings, background=background)


def _check_recorded_view(recording: RecordingFile) -> None:
    """Refuse a recording without the directions of its pixels before it is estimated."""
    remedy = "import it with --fov HxV or --intrinsics"
    try:
        optics = recording.sensor.optics
        if optics is not None:
            optics.check(recording.shape[1:])
    except ValueError as error:
        raise BadInputError(f"{recording.path}: sensor: {error}; {remedy}") from error
    if optics is None:
        raise BadInputError(f"{recording.path}: the directions of its pixels are not known; {remedy}")


@contextmanager
def estimated(recording: Path, workers: int, reporter: Reporter, *, about: About | None = None) -> Iterator[LayersFile]:
    """Estimate a recording into a file for the time of the block; messages are about `about`, else the recording."""
    request = EstimateRequest(options=EstimateOptions(), workers=workers)
    with TemporaryDirectory(prefix="tofmix-") as folder:
        target = Path(folder) / f"{recording.stem}.layers.h5"
        estimate_file(
            recording,
            target,
            request,
            FileRequest(memory_bytes=_MEMORY_BYTES),
            None,
            reporter,
            about=about or About(recording),
        )
        with open_layers(target) as layers:
            yield layers


def settings_of(recording: RecordingFile) -> RecordingSettings:
    """As many frames as a recording has, at its rate."""
    time_s, frames = recording.read_time(), recording.shape[0] // max(1, recording.targets)
    return recording_settings(frames, time_s)


def recording_settings(frames: int, time_s: FloatArray | None) -> RecordingSettings:
    """Settings of so many frames at the usual rate of their times; the default rate where it is not known."""
    steps = np.zeros(0) if time_s is None else np.diff(time_s)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    settings = RecordingSettings(frames=max(1, frames))
    return replace(settings, frame_rate_hz=round(1.0 / float(np.median(steps)), 6)) if len(steps) else settings


def scene_of_layers(
    layers: LayersSource,
    name: str,
    reporter: Reporter,
    *,
    window: int,
    recording: RecordingSettings | None = None,
    background: str = BACKGROUND_MAP,
) -> PlaneScene:
    """The model of the layers of one window; arguments and refusals as of `scene_of_file`."""
    if isinstance(layers, LayersFile):
        check_view(layers, own_remedy=f"give them to {next_command('surfaces', layers.path, '--fov', 'HxV')}, or ")
    sensor, one = layers.provenance.sensor, layers.read_window(window)
    try:
        found = reconstruct(one, sensor)
    except ValueError as error:
        raise BadInputError(f"{name}: window {window}: {error}") from error
    frames = int(layers.window_stop[window] - layers.window_start[window])
    seen = _Seen(
        found=found,
        numbers=np.arange(len(found.planes)),
        sensor=sensor,
        layers=one,
        source=name,
        window=window,
        recording=recording or recording_settings(frames, None),
    )
    return _scene(seen, reporter, background)


def _scene(seen: _Seen, reporter: Reporter, background: str) -> PlaneScene:
    """The rectangles of a window's planes as a model."""
    curve, notes = _noise(seen)
    camera, assumed = _camera(seen, curve)
    notes += [*assumed, *_not_written(seen.sensor)]
    flat = seen.numbers[~seen.found.planes.is_smooth[seen.numbers]].tolist()
    try:
        found = {k: _rectangle(seen, k, camera.range_max_mm) for k in flat}
    except ValueError as error:
        raise BadInputError(f"{seen.source}: {error}") from error
    shown = {k: surface for k, surface in found.items() if surface is not None}
    kept, changed = _kept(seen, camera, shown)
    if not kept:
        raise BadInputError(
            f"{seen.source}: window {seen.window}: no plane among its {counted(len(seen.numbers), 'surface')}, and a"
            " model has flat rectangles; record a scene with flat surfaces"
        )
    light, unit = _reflectivities(seen, list(kept), camera.integration_time_ms)
    if camera.noise.law is not None:
        law = None if unit is None else camera.noise.law.scaled(1.0 / unit)
        notes += [] if law is not None else ["noise by amplitude is written for usual amplitudes: none are known here"]
        camera = replace(camera, noise=replace(camera.noise, law=law))
    for note in notes:
        reporter.note(f"{seen.source}: {note}")
    surfaces = {k: replace(surface, reflectivity=light.get(k, USUAL_REFLECTIVITY)) for k, surface in kept.items()}
    model, shares = _model(seen, camera, surfaces, notes, background)
    values = {
        "window": seen.window,
        "surfaces": len(kept),
        "smooth_surfaces": len(seen.numbers) - len(flat),
        "hidden_surfaces": len(flat) - len(shown),
        "covering_surfaces": len(shown) - len(kept),
        "suspect_left_out": 0 if seen.layers is None else seen.layers.suspects(),
        "pixels": int(changed.size),
        "pixels_changed": int(changed.sum()),
        "notes": notes,
    }
    return PlaneScene(model=model, background=shares, values=values)


def _kept(seen: _Seen, camera: CompleteCamera, surfaces: dict[int, Surface]) -> tuple[dict[int, Surface], BoolArray]:
    """The rectangles that describe more than they cover of others, and the pixels (row, col) whose shares they change.

    Without its rectangle a surface loses its shares; with it, others lose what it covers of them. The smaller loss is
    chosen. What a rectangle covers only grows where others are left out, so none is left out too early.
    """
    factor, (rows, cols) = seen.found.factor, seen.shape
    parts = seen.found.surface_fine.reshape(rows, factor, cols, factor)
    before = {k: (parts == k).mean(axis=(1, 3), dtype=np.float32) for k in seen.numbers.tolist()}
    kept = surfaces
    while True:
        truth = cast_scene(Model(sensor=camera, surfaces=tuple(kept.values())))
        weight = np.nan_to_num(truth.weight_true)
        weight /= (weight.sum(axis=2) + truth.weight_no_return)[:, :, np.newaxis]
        place = {number: k for k, number in enumerate(kept)}
        changed, covering = np.zeros((rows, cols), dtype=np.bool_), set()
        for number, share in before.items():
            after = np.where(truth.surface == place.get(number, len(place)), weight, 0.0).sum(axis=2)
            changed |= np.abs(share - after) > CHANGED
            if number in kept and np.maximum(after - share, 0.0).sum() > share.sum():
                covering.add(number)
        if not covering:
            return kept, changed
        kept = {number: surface for number, surface in kept.items() if number not in covering}


def _model(
    seen: _Seen,
    camera: CompleteCamera,
    surfaces: dict[int, Surface],
    notes: Sequence[str],
    background: str,
) -> tuple[Model, Float32Array | None]:
    """The model, read back from its text, and its map of background shares."""
    planes, of_each = seen.found.planes, camera.noise.background
    shares = None if of_each is None or of_each.ndim == 0 else of_each.astype(np.float32)
    text = model_text(
        camera,
        list(surfaces.values()),
        seen.recording,
        _effects(seen.sensor),
        background=None if shares is None else background,
        remarks=[
            f"what {Path(seen.source).name} saw, as rectangles: written by tofmix {__version__} scene --planes",
            *notes,
        ],
        about=[
            f"{counted(int(planes.n_pixels[k]), 'layer', ',')}, rms {planes.rms_mm[k]:.3g} mm about the plane"
            for k in surfaces
        ],
    )
    return parse_model(text, source=seen.source, read_map=lambda _path, _shape: _required(shares)), shares


def _required(shares: Float32Array | None) -> Float32Array:
    if shares is None:
        raise ValueError("no map is named")
    return shares


def _rectangle(seen: _Seen, number: int, reach_mm: float) -> Surface | None:
    """The rectangle of a plane; None if it is nowhere the nearest."""
    rectangle = outline_rectangle(seen.found, number, seen.optics, reach_mm=reach_mm)
    if rectangle is None:
        return None
    return surface_along(
        f"surface {number}", center_mm=rectangle.center_mm, size_mm=rectangle.size_mm, axes=rectangle.axes
    )


def _reflectivities(
    seen: _Seen, written: Sequence[int], integration_time_ms: float
) -> tuple[dict[int, float], float | None]:
    """Reflectivity of each surface with amplitudes, and the camera's unit of amplitudes over the model's.

    A camera may count in any unit: where reflectivities would be above 1, the brightest surface has 1.
    """
    layers, found = seen.layers, seen.found
    if layers is None or layers.amplitude is None:
        return {}, None
    directions = beam_directions_of(seen.optics, seen.shape)
    ratios = {}
    for number in written:
        row, col, layer = np.nonzero(found.surface == number)
        cosine = np.abs(directions[row, col] @ found.planes.normal[number].astype(np.float64))
        range_mm = layers.range[row, col, layer].astype(np.float64)
        white = 1000.0 * integration_time_ms / 1.2 * cosine * (1000.0 / range_mm) ** 2
        ratio = layers.amplitude[row, col, layer] / white
        known = ratio[np.isfinite(ratio) & (ratio > 0)]
        if len(known):
            ratios[number] = float(np.median(known))
    if not ratios:
        return {}, None
    unit = max(1.0, *ratios.values())
    return {number: ratio / unit for number, ratio in ratios.items()}, unit


def _noise(seen: _Seen) -> tuple[NoiseCurve, list[str]]:
    """The noise curve in the form that a model has, and what it leaves out."""
    curve = seen.sensor.noise
    if curve is None:
        raise BadInputError(f"{seen.source}: sensor: no noise curve; estimate its recording with --noise auto")
    if curve.background_density is None:
        return curve, []
    return replace(curve, background_density=None), ["random values are uniform over the range here, as in any model"]


def _camera(seen: _Seen, curve: NoiseCurve) -> tuple[CompleteCamera, list[str]]:
    """The camera of a model, and what was assumed of it."""
    longest = float(np.nanmax(seen.found.range_fine, initial=1.0))
    try:
        return camera_of(replace(seen.sensor, noise=curve), seen.shape, longest_mm=longest)
    except ValueError as error:
        raise BadInputError(f"{seen.source}: sensor: {error}") from error


def _not_written(sensor: Sensor) -> list[str]:
    """What the camera has and a model has not."""
    notes = []
    if sensor.share_law is not None and sensor.share_law is not ShareLaw.AREA:
        notes.append(f"share_law is {sensor.share_law.value}; samples are simulated by area")
    if sensor.follows_drift:
        notes.append("the drift of its pixels' ranges is left out")
    if sensor.temporal_filter is not None:
        notes.append(f"the camera's {sensor.temporal_filter.kind} filter over time is left out")
    if sensor.no_return_mm is not None:
        notes.append(
            f"samples without a return scatter around range_max_mm; the camera gave {sensor.no_return_mm:g} mm"
        )
    return notes


def _effects(sensor: Sensor) -> list[Effect]:
    """Parts of the noise that are effects of a model: the step of the ranges, and memory from frame to frame."""
    step, effects = sensor.range_step_mm, list[Effect]()
    if sensor.learnt is not None and sensor.learnt.memory > 0:
        effects.append(TemporalCorrelation(coefficient=round(sensor.learnt.memory, 4)))
    if step is not None and step.ndim == 0 and float(step) > WHOLE_MM:
        effects.append(Quantisation(step_mm=float(step)))
    return effects
