"""``tofmix reconcile``: a model and a measurement in, the missing effects out."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import PATH, examples, json_option, note, overwrite_option
from tofmix.cli.progress import Progress

if TYPE_CHECKING:
    from collections.abc import Callable

    from tofmix.arrays import FloatArray
    from tofmix.io.recording.recording_file import RecordingFile
    from tofmix.reconciliation.evidence import Evidence
    from tofmix.reconciliation.workflow import Reconciliation
    from tofmix.sensor import Sensor
    from tofmix.simulation.model import Model

    Files = tuple[tuple[str, Path], ...]
    Recordings = list[tuple[Model, Evidence]]

_MOST_SAMPLES = 1 << 28  # samples held in memory: a gigabyte
_SAME = 1e-3  # relative difference of numbers of a camera that are written in a file
_SAME_PLACE = 0.1  # part of a pixel: directions that differ by less are the same
_SAME_RATE = 0.02  # relative difference of frame rates: clocks are not exact


@examples(
    """
tofmix reconcile my_scene.toml measured.h5 -o gap
tofmix reconcile my_scene.toml measured.h5 -o gap --effects wiggling,range_offset,surface_pose
tofmix reconcile near.toml near.h5 -o gap --also far.toml far.h5
tofmix reconcile my_scene.toml measured.h5 -o gap --noise measured
tofmix simulate gap/model.toml -o refined.h5
"""
)
@click.command(short_help="Name the effect that a simulation lacks.")
@click.argument("model")
@click.argument("measured", type=PATH)
@click.option(
    "-o",
    "--output",
    type=PATH,
    required=True,
    help="Folder for model.toml, suggested_model.toml, gap.json and report.html.",
)
@click.option(
    "--also", type=(str, PATH), multiple=True, metavar="MODEL MEASURED",
    help="Another recording of the same camera, with the model of its scene. Repeatable.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of every random draw.")
@click.option("--effects", metavar="A,B,...", help="Kinds of effects to try.  [default: all]")
@click.option("--max-effects", type=click.IntRange(0, 10), default=3, show_default=True, help="Most effects to add.")
@click.option(
    "--alpha", type=click.FloatRange(0, 0.5, min_open=True), default=0.01, show_default=True,
    help="Significance level of the tests, corrected for their number.",
)  # fmt: skip
@click.option(
    "--tolerance", type=click.FloatRange(0, 1), default=0.1, show_default=True,
    help="Accepted model error: pose errors up to this many sigma, and sigma errors up to a tenth of this share.",
)  # fmt: skip
@click.option(
    "--noise", metavar="model|measured|LAYERS.h5",
    help="The model's noise, noise learnt from MEASURED, or that of a layers file.  [default: model; where this"
    " explains nothing, measured is tried too]",
)  # fmt: skip
@click.option(
    "--split", type=click.Choice(["frames,pixels", "frames", "pixels"]), default="frames,pixels", show_default=True,
    help="Data held out from the fit: frames, pixels or both.",
)  # fmt: skip
@json_option
@overwrite_option
def reconcile(
    model: str,
    measured: Path,
    output: Path,
    also: tuple[tuple[str, Path], ...],
    seed: int,
    effects: str | None,
    max_effects: int,
    alpha: float,
    tolerance: float,
    noise: str | None,
    split: str,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Find where a simulation of MODEL and the recording MEASURED disagree, name the missing effect, and add it.

    The command compares each sample with the model's prediction, locates the
    disagreement, fits the known effects, scores them on held-out frames and pixels,
    and adds the effects that explain the disagreement. The verdict states whether
    any effect does. Recordings given with --also share the effects' parameters.
    docs/reference/verdicts.md explains the verdicts.
    """
    from tofmix.io.reconciliation import locked_folder, model_names, suggested_names
    from tofmix.reconciliation.measured_noise import MODEL, is_open, with_fallback, with_note
    from tofmix.reconciliation.search.search_state import Settings
    from tofmix.reconciliation.words import summary_lines
    from tofmix.reconciliation.workflow import reconcile as run

    kinds = _kinds(effects)
    files = ((model, measured), *also)
    settings = Settings(kinds=kinds, max_effects=max_effects, alpha=alpha, tolerance=tolerance, split=split, seed=seed)
    with locked_folder(output, overwrite=overwrite, models=len(files)):
        recordings = _read_all(files)
        other = None if noise in (None, MODEL) else _with_noise(recordings, measured, str(noise))
        with Progress(len(kinds) * max(max_effects, 1), "reconcile", "kind") as bar:

            def tick(_: str) -> None:
                if bar.done == bar.total:  # another way is tried
                    bar.total += len(kinds)
                bar.update(1)

            def found(recordings: "Recordings") -> "Reconciliation":
                return run(*recordings[0], settings, tick, also=recordings[1:])

            result = found(recordings if other is None else other)
            if other is not None:
                result = with_note((result, other), recordings, settings)
            if noise is None and is_open(result):
                with bar.aside():
                    other = _tried_noise(recordings, measured)
                if other is not None:
                    result = with_fallback((result, recordings), (found(other), other), settings)
            bar.total = bar.done  # no other way is tried: the page is left
            bar.describe("reconcile: page")
            _write(result, files, output, overwrite)
    if as_json:
        click.echo(json.dumps(result.as_dict(), indent=2, allow_nan=False))
        return
    click.echo("\n".join(summary_lines(result)))
    more = suggested_names(len(files)) if result.suggested else []
    names = ", ".join([*model_names(len(files))[1:], *more, "gap.json", "report.html"])
    click.echo(f"wrote        {output / 'model.toml'}, {names}")


def _kinds(effects: str | None) -> tuple[str, ...]:
    from tofmix.errors import UsageError
    from tofmix.reconciliation.search.name import KINDS
    from tofmix.toml_table import nearest

    if effects is None:
        return KINDS
    wanted = [name.strip() for name in effects.split(",") if name.strip()]
    for name in wanted:
        if name not in KINDS:
            raise UsageError(f'--effects: "{name}" is not an effect{nearest(name, KINDS)}')
    if not wanted:
        raise UsageError("--effects: the list is empty; name an effect, or leave the option out")
    return tuple(kind for kind in KINDS if kind in wanted)


def _read_all(files: "Files") -> list[tuple["Model", "Evidence"]]:
    """Models and recordings; models before recordings, which take longer to read."""
    from tofmix.errors import BadInputError
    from tofmix.io.model_file import load_model
    from tofmix.reconciliation.likelihood.joint import check_camera

    models = [load_model(model) for model, _ in files]
    for (name, _), model in zip(files, models, strict=True):
        if not model.surfaces:
            raise BadInputError(f"{name}: surface: the model has no surface; add one to compare with the recording")
    for (name, _), model in zip(files[1:], models[1:], strict=True):
        try:
            check_camera([models[0], model])
        except BadInputError as error:
            raise BadInputError(f"{name}: {error}") from error
    return [(model, _read(model, measured)) for model, (_, measured) in zip(models, files, strict=True)]


def _read(scene: "Model", measured: Path) -> "Evidence":
    import numpy as np

    from tofmix.cli.reporter import CommandReporter
    from tofmix.errors import BadInputError
    from tofmix.io.next_command import import_command
    from tofmix.jobs.recordings import opened_recording
    from tofmix.reconciliation.evidence import make_evidence

    every = slice(0, None)
    with opened_recording(measured, CommandReporter()) as file:
        if file.targets:
            raise BadInputError(
                f"{measured}: range: {file.targets} targets a pixel and frame; reconcile compares one sample a frame."
                f" Keep one of them: {import_command(measured, '--target', 'nearest')}"
            )
        samples = math.prod(file.shape)
        if samples > _MOST_SAMPLES:
            raise BadInputError(
                f"{measured}: range: {samples:,} samples; reconcile holds them all in memory, {_MOST_SAMPLES:,} at most"
            )
        range_mm, time_s = file.read_range(every, every), file.read_time()
        amplitude = file.read_amplitude(every, every) if file.has_amplitude else None
        temperature_c, integration_time_ms = file.read_temperature(), file.sensor.integration_time_ms
        for name in ("modulation_frequency_hz", "integration_time_ms"):
            own, models = getattr(file.sensor, name), getattr(scene.sensor, name)
            if own is not None and models is not None and not math.isclose(own, models, rel_tol=_SAME):
                click.echo(f"tofmix: {measured}: sensor: {name} is {own:g}; the model has {models:g}", err=True)
        _say_other_optics(measured, file, scene)
    if time_s is not None and time_s[-1] > time_s[0]:
        models = scene.recording.frame_rate_hz
        steps = np.diff(time_s)
        mean, usual = 1.0 / float(steps.mean()), 1.0 / float(np.median(steps[steps > 0]))
        if not any(math.isclose(own, models, rel_tol=_SAME_RATE) for own in (mean, usual)):  # a pause is no other rate
            click.echo(f"tofmix: {measured}: time: {usual:.4g} Hz; the model has frame_rate_hz {models:g}", err=True)
    if any(effect.kind == "fixed_pattern" and getattr(effect, "map", None) is None for effect in scene.effects):
        click.echo(
            f"tofmix: {measured}: the model's fixed_pattern has no map: every static error counts as part of the"
            " pattern",
            err=True,
        )
    if scene.sensor.noise.width_spread:
        click.echo(
            f"tofmix: {measured}: the model has width_spread without a width for each pixel: every difference"
            " between the noise of pixels counts as width",
            err=True,
        )
    try:
        return make_evidence(
            scene, range_mm, time_s=time_s, amplitude=amplitude, temperature_c=temperature_c,
            integration_time_ms=integration_time_ms,
        )  # fmt: skip
    except BadInputError as error:
        raise BadInputError(f"{measured}: {error}") from error


def _with_noise(recordings: "Recordings", measured: Path, noise: str) -> "Recordings":
    """The models with the noise that `noise` names; one camera has one noise.

    Raises
    ------
    BadInputError
        If the samples determine no noise, or the layers file has none.
    UsageError
        If `noise` is no choice and no file.
    """
    from tofmix.errors import BadInputError, UsageError
    from tofmix.reconciliation.measured_noise import MEASURED, measured_models

    if noise == MEASURED:
        sensor = _learnt_sensor(measured)
    elif Path(noise).exists():
        from tofmix.io.layers.layers_file import open_layers

        with open_layers(Path(noise)) as layers:
            sensor = layers.provenance.sensor
        if sensor.noise is None:
            raise BadInputError(f"{noise}: sensor/noise_sigma: no noise curve")
    else:
        raise UsageError(f'--noise: "{noise}" is not model, measured or a layers file: no such file')
    return measured_models(recordings, sensor)


def _tried_noise(recordings: "Recordings", measured: Path) -> "Recordings | None":
    """The models with the noise of the recording; None if its samples determine none."""
    from tofmix.errors import BadInputError
    from tofmix.reconciliation.measured_noise import MEASURED

    try:
        return _with_noise(recordings, measured, MEASURED)
    except BadInputError as error:
        note(f"the noise of the recording is not tried: {error}")
        return None


def _learnt_sensor(measured: Path) -> "Sensor":
    from tofmix.cli.reporter import CommandReporter
    from tofmix.io.recording.recording_file import open_recording
    from tofmix.jobs.estimate import learnt_sensor

    with open_recording(measured) as source:
        return learnt_sensor(source, CommandReporter())


def _say_other_optics(measured: Path, file: "RecordingFile", scene: "Model") -> None:
    """Print a line if the pixels of the recording and of the model look in different directions."""
    from tofmix.errors import BadInputError
    from tofmix.optics.geometry import largest_angle_deg
    from tofmix.optics.projection import beam_directions_of, pixel_extent_rad

    shape, models = file.shape[1:], scene.sensor.optics
    try:
        own = file.sensor.optics
        if own is None or own == models or shape != scene.sensor.shape:
            return
        off_deg = largest_angle_deg(beam_directions_of(own, shape), beam_directions_of(models, shape))
    except ValueError as error:
        raise BadInputError(f"{measured}: sensor: {error}") from error
    if off_deg > _SAME_PLACE * math.degrees(float(pixel_extent_rad(models, shape).min())):
        click.echo(
            f"tofmix: {measured}: sensor: its pixels see {own.words(shape)}; the model's see {models.words(shape)};"
            f" directions differ by up to {off_deg:.2g} degrees",
            err=True,
        )


def _write(result: "Reconciliation", files: "Files", output: Path, overwrite: bool) -> None:
    from tofmix.io.reconciliation import write_folder
    from tofmix.reconciliation.words import effect_tables, suggested_tables
    from tofmix.report.gap.page import render_gap

    def texts(tables: "Callable[[Reconciliation, int], str]") -> list[str]:
        found = [(model.text.rstrip("\n") + "\n", tables(result, k)) for k, model in enumerate(result.models)]
        return [f"{text}\n{more}" if more else text for text, more in found]

    maps = _maps(result)
    page = render_gap(result, source=" and ".join(measured.name for _, measured in files))
    inputs = tuple(path for model, measured in files for path in (Path(model), measured) if path.exists())
    write_folder(
        output, model_texts=texts(effect_tables), maps=maps, gap=result.as_dict(), page=page, overwrite=overwrite,
        inputs=inputs, suggested_texts=texts(suggested_tables) if result.suggested else (),
    )  # fmt: skip


def _maps(result: "Reconciliation") -> "dict[str, FloatArray]":
    """The maps (row, col) of the refined models by their paths in the models' folder."""
    import numpy as np

    from tofmix.errors import BadInputError
    from tofmix.reconciliation.workflow import maps_of
    from tofmix.simulation.model_toml import background_path

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
