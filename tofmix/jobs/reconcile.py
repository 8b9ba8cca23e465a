"""Reconcile models with recordings: checks, doubts, the noise that is tried, and the folder of results."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.io.layers.layers_file import open_layers
from tofmix.io.next_command import import_command
from tofmix.io.reconciliation import write_folder
from tofmix.jobs.reference import SAME, check_same_camera
from tofmix.jobs.reporter import OptionError, Reporter
from tofmix.optics.projection import beam_directions_of, largest_angle_deg, pixel_extent_rad
from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.found import Ledger
from tofmix.reconciliation.likelihood.joint import check_camera
from tofmix.reconciliation.measured_noise import (
    MEASURED,
    MODEL,
    is_open,
    measured_models,
    with_fallback,
    with_note,
)
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.words import effect_tables, suggested_tables
from tofmix.reconciliation.workflow import Reconciliation, maps_of
from tofmix.reconciliation.workflow import reconcile as search
from tofmix.recording import CameraSource, amplitude_source
from tofmix.report.gap import render_gap
from tofmix.sensor import Sensor
from tofmix.simulation.effects.base import with_hidden
from tofmix.simulation.effects.hidden import PixelBias
from tofmix.simulation.measured_scene import LEAST_SAMPLES, MeasuredScene
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import background_path
from tofmix.toml_table import nearest
from tofmix.wording import counted

Recordings = list[tuple[Model, Evidence]]

_MOST_SAMPLES = 1 << 28  # samples held in memory: a gigabyte


def kinds_of(effects: Sequence[str] | None, reporter: Reporter) -> tuple[str, ...]:
    """The kinds of effects to try, in the order in which they are tried; all without a list."""
    if effects is None:
        return KINDS
    for name in effects:
        if name not in KINDS:
            raise OptionError(f'{reporter.option("effects")}: "{name}" is not an effect{nearest(name, KINDS)}')
    if not effects:
        raise OptionError(f"{reporter.option('effects')}: the list is empty; name an effect, or leave the option out")
    return tuple(kind for kind in KINDS if kind in effects)


def check_models(models: Sequence[tuple[str, Model]]) -> None:
    """Refuse named models that no recording, or not one camera, can be compared with."""
    for name, model in models:
        if model.scene is None and not model.surfaces:
            raise BadInputError(f"{name}: surface: the model has no surface; add one to compare with the recording")
    for name, model in models[1:]:
        try:
            check_camera([models[0][1], model])
        except BadInputError as error:
            raise BadInputError(f"{name}: {error}") from error


def read_evidence(
    model: Model,
    source: CameraSource,
    reporter: Reporter,
    *,
    time_s: FloatArray | None,
    temperature_c: FloatArray | None,
    after: int = 0,
) -> Evidence:
    """Read a recording into memory, from frame `after` on, and say where it and the model differ."""
    name, every, model = source.name, slice(None), _compared(model)
    if source.targets:
        raise BadInputError(
            f"{name}: range: {source.targets} targets a pixel and frame; reconcile compares one sample a frame."
            f" Keep one of them: {import_command(Path(name), '--target', 'nearest')}"
        )
    if (samples := math.prod(source.shape)) > _MOST_SAMPLES:
        raise BadInputError(
            f"{name}: range: {samples:,} samples; reconcile holds them all in memory, {_MOST_SAMPLES:,} at most"
        )
    light = amplitude_source(source)
    range_mm, begins_s = source.read_range(every, every), 0.0
    amplitude = None if light is None else light.read_amplitude(every, every)
    if model.scene is not None:
        check_same_camera(model.scene, model.sensor.sensor(), name, source.sensor, source.shape[1:])
        range_mm, kept = _of_scene(model.scene, source, range_mm, after, reporter)
        begins_s = _since_middle(kept[0], after, time_s, model.recording.frame_rate_hz)
        amplitude = None if amplitude is None else amplitude[kept]
        time_s, temperature_c = (None if x is None else x[kept] for x in (time_s, temperature_c))
    for number in ("modulation_frequency_hz", "integration_time_ms"):
        own, models = getattr(source.sensor, number), getattr(model.sensor, number)
        if own is not None and models is not None and not math.isclose(own, models, rel_tol=SAME):
            reporter.warn(f"{name}: sensor: {number} is {own:g}; the model has {models:g}")
    _say_other_optics(source, model, reporter)
    _say_other_rate(name, time_s, model, after, reporter)
    for effect, hidden in with_hidden(model.effects, PixelBias):
        if hidden.map_of(effect) is None:
            reporter.warn(
                f"{name}: the model's {effect.kind} has no map: every static error counts as part of the pattern"
            )
    if model.sensor.noise.width_spread:
        reporter.warn(
            f"{name}: the model has width_spread without a width for each pixel: every difference between the noise of"
            " pixels counts as width"
        )
    try:
        return make_evidence(
            model,
            range_mm,
            time_s=time_s,
            amplitude=amplitude,
            temperature_c=temperature_c,
            integration_time_ms=source.sensor.integration_time_ms,
            begins_s=begins_s,
        )
    except BadInputError as error:
        raise BadInputError(f"{name}: {error}") from error


def _of_scene(
    scene: MeasuredScene, source: CameraSource, range_mm: Float32Array, after: int, reporter: Reporter
) -> tuple[Float32Array, IntArray]:
    """The samples that are compared with a scene, and the numbers of their frames.

    Those of pixels that the scene does not know are left out, and those that may see more than it knows, and frames
    that a filter of the camera has made of the frames before, as those of the scene are.
    """
    unknown, beside = ~scene.known, scene.beside_others & scene.known
    if unknown.any():
        reporter.note(
            f"{source.name}: {counted(int(unknown.sum()), 'pixel', ',')} left out: the reference has fewer than"
            f" {LEAST_SAMPLES} samples there"
        )
    if beside.any():
        reporter.note(
            f"{source.name}: {counted(int(beside.sum()), 'pixel', ',')} left out: a neighbour sees another surface, of"
            " which the pixel may see a little"
        )
    range_mm = np.where(unknown | beside | ~np.isfinite(range_mm), np.float32(np.nan), range_mm)
    kept = np.arange(after, len(range_mm), scene.every)
    return range_mm[kept], kept


def _compared(model: Model) -> Model:
    """The model, with a measured scene as it is compared."""
    return model if model.scene is None else replace(model, scene=model.scene.compared())


def _since_middle(first: int, reference: int, time_s: FloatArray | None, frame_rate_hz: float) -> float:
    """Time of the first compared frame since the middle of the reference, s, if this is the frames before; else 0.

    What moves steadily moves within the reference too, whose means are those of its middle.
    """
    if not reference:
        return 0.0
    if time_s is None:
        return (first - (reference - 1) / 2) / frame_rate_hz
    return max(float(time_s[first] - time_s[:reference].mean()), 0.0)


def _say_other_optics(source: CameraSource, model: Model, reporter: Reporter) -> None:
    """Say if the pixels of the recording and of the model look in different directions."""
    shape, models, own = source.shape[1:], model.sensor.optics, source.sensor.optics
    if own is None or own == models or shape != model.sensor.shape:
        return
    try:
        off_deg = largest_angle_deg(beam_directions_of(own, shape), beam_directions_of(models, shape))
    except ValueError as error:
        raise BadInputError(f"{source.name}: sensor: {error}") from error
    same_place = 0.1  # part of a pixel: directions that differ by less are the same
    if off_deg > same_place * math.degrees(float(pixel_extent_rad(models, shape).min())):
        if model.scene is not None:
            raise BadInputError(
                f"{source.name}: sensor: another lens than the reference's: directions of pixels differ by up to"
                f" {off_deg:.2g} degrees"
            )
        reporter.warn(
            f"{source.name}: sensor: its pixels see {own.words(shape)}; the model's see {models.words(shape)};"
            f" directions differ by up to {off_deg:.2g} degrees"
        )


def _say_other_rate(name: str, time_s: FloatArray | None, model: Model, after: int, reporter: Reporter) -> None:
    """Say if frames follow each other at another rate than the model's; it is their own where `after` are its scene."""
    if after or time_s is None or time_s[-1] <= time_s[0]:
        return
    models, steps = model.recording.frame_rate_hz, np.diff(time_s)
    mean, usual = 1.0 / float(steps.mean()), 1.0 / float(np.median(steps[steps > 0]))
    same_rate = 0.02  # relative difference of frame rates: clocks are not exact
    if not any(math.isclose(own, models, rel_tol=same_rate) for own in (mean, usual)):  # a pause is no other rate
        reporter.warn(f"{name}: time: {usual:.4g} Hz; the model has frame_rate_hz {models:g}")


def reconcile(
    recordings: Recordings,
    settings: Settings,
    noise: str | Sensor | None,
    learnt: Callable[[], Sensor],
    reporter: Reporter,
) -> Reconciliation:
    """Find the effects that the models lack.

    Parameters
    ----------
    recordings : list of (Model, Evidence)
        Of one camera.
    noise : str, Sensor or None
        ``model``, ``measured``, a layers file, or a camera. Without it the model's, and the measured one where the
        model's leaves something unexplained.
    learnt : callable
        Gives the camera of the first recording with the noise of its samples.
    reporter : Reporter
        Receives a step of progress for each kind that was tried, and each set of effects that was weighed. If it is
        stopped, the search ends between two sets, with the best so far.
    """
    recordings = [(_compared(model), evidence) for model, evidence in recordings]
    measured = any(model.scene is not None for model, _ in recordings)
    if measured and noise not in (None, MODEL):
        raise OptionError(
            f"{reporter.option('noise')}: the noise of a measured scene is compared too; leave the option out"
        )
    if measured and len(recordings) > 1:
        raise OptionError(f"{reporter.option('also')}: a measured scene is compared with one recording")

    def found(recordings: Recordings) -> Reconciliation:
        ledger = Ledger(lambda weighed: reporter.weighed(weighed.line), reporter.is_stopped)
        return search(*recordings[0], settings, lambda _: reporter.progress(1), also=recordings[1:], ledger=ledger)

    if noise not in (None, MODEL):
        other = measured_models(recordings, _sensor_of(noise, learnt, reporter))
        return with_note((found(other), other), recordings, settings)
    result = found(recordings)
    if noise is None and not measured and is_open(result) and result.is_complete:
        try:
            with reporter.aside():
                other = measured_models(recordings, learnt())
        except BadInputError as error:
            reporter.note(f"the noise of the recording is not tried: {error}")
            return result
        again = found(other)
        best = with_fallback((result, recordings), (again, other), settings)
        return replace(best, is_complete=again.is_complete)
    return result


def _sensor_of(noise: str | Sensor | None, learnt: Callable[[], Sensor], reporter: Reporter) -> Sensor:
    """The camera whose noise replaces the models'."""
    if isinstance(noise, Sensor):
        return noise
    if noise == MEASURED:
        with reporter.aside():
            return learnt()
    path = Path(str(noise))
    if not path.exists():
        raise OptionError(
            f'{reporter.option("noise")}: "{noise}" is not model, measured or a layers file: no such file'
        )
    with open_layers(path) as layers:
        sensor = layers.provenance.sensor
    if sensor.noise is None:
        raise BadInputError(f"{noise}: sensor/noise_sigma: no noise curve")
    return sensor


def write_reconciliation(
    result: Reconciliation,
    files: Sequence[tuple[str, Path]],
    output: Path,
    *,
    overwrite: bool,
    beside: Mapping[str, bytes] = MappingProxyType({}),
) -> None:
    """Write the folder of a reconciliation of models with recordings; `beside` are further files that models name."""

    def texts(tables: Callable[[Reconciliation, int], str]) -> list[str]:
        found = [(model.text.rstrip("\n") + "\n", tables(result, k)) for k, model in enumerate(result.models)]
        return [f"{text}\n{more}" if more else text for text, more in found]

    maps = _maps(result)
    page = render_gap(result, source=" and ".join(measured.name for _, measured in files))
    inputs = tuple(path for model, measured in files for path in (Path(model), measured) if path.exists())
    write_folder(
        output,
        model_texts=texts(effect_tables),
        maps=maps,
        gap=result.as_dict(),
        page=page,
        overwrite=overwrite,
        inputs=inputs,
        suggested_texts=texts(suggested_tables) if result.has_advice else (),
        beside=dict(beside) | _scene_files(result, files, beside),
    )


def _scene_files(
    result: Reconciliation, files: Sequence[tuple[str, Path]], known: Mapping[str, bytes]
) -> dict[str, bytes]:
    """The files that a model names in ``[scene]``, by their paths: refined models name them too."""
    found: dict[str, bytes] = {}
    for model, (name, _) in zip(result.models, files, strict=True):
        paths = () if model.scene is None else (model.scene.layers_path, model.scene.surfaces_path)
        for path in paths:
            if path and path not in known:
                found[path] = (Path(name).parent / path).read_bytes()
    return found


def _maps(result: "Reconciliation") -> dict[str, FloatArray]:
    """The maps (row, col) of the refined models by their paths in the models' folder."""
    of_effects = (*(e for m in result.models for e in m.effects), *(named.effect for named in result.named))
    of_noise = ((background_path(m), m.sensor.noise.background) for m in result.models)
    found = [item for effect in of_effects for item in maps_of(effect).items()]
    found += [(path, values) for path, values in of_noise if path is not None and values is not None]
    maps: dict[str, FloatArray] = {}
    for path, values in found:
        if path in maps and not np.array_equal(maps[path], values, equal_nan=True):
            raise BadInputError(f"map: two models of one camera have different maps with the name {path}; rename one")
        maps[path] = values
    return maps
