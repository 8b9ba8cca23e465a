"""``tofmix reconcile``: a model and a measurement in, the missing effects out."""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import PATH, declared, default_workers, examples, json_option, overwrite_option
from tofmix.cli.reporter import CommandReporter, Progress
from tofmix.options import RECONCILE

if TYPE_CHECKING:
    from tofmix.jobs.reference import Reference
    from tofmix.sensor import Sensor


_INTERRUPTED = b"\ntofmix: interrupted: the best so far is written; Ctrl-C again ends at once, and writes nothing\n"


@examples(
    """
tofmix reconcile my_scene.toml measured.h5 -o gap
tofmix reconcile my_scene.toml measured.h5 -o gap --effects wiggling,range_offset,surface_pose
tofmix reconcile near.toml near.h5 -o gap --also far.toml far.h5
tofmix reconcile my_scene.toml measured.h5 -o gap --noise measured
tofmix reconcile yesterday.h5 today.h5 -o gap
tofmix reconcile --self measured.h5 -o gap
tofmix simulate gap/model.toml -o refined.h5
"""
)
@click.command(short_help="Name the effect that a simulation lacks.")
@click.argument("model", required=False)
@click.argument("measured", type=PATH, required=False)
@click.option(
    "-o",
    "--output",
    type=PATH,
    required=True,
    help="Folder for model.toml, suggested_model.toml, gap.json and report.html.",
)
@click.option(
    "--also",
    type=(str, PATH),
    multiple=True,
    metavar="MODEL MEASURED",
    help="Another recording of the same camera, with the model of its scene. Repeatable.",
)
@click.option(
    "--self",
    is_flag=False,
    flag_value="",
    metavar="[SHARE|FRAMES]",
    help="Take the first frames of MEASURED as the reference, and compare the rest with them: a share below 1, or a"
    " number of frames.  [default: a third]",
)
@declared(RECONCILE, "seed")
@click.option("--effects", metavar="A,B,...", help="Kinds of effects to try.  [default: all]")
@declared(RECONCILE, "max_effects")
@declared(RECONCILE, "alpha")
@declared(RECONCILE, "tolerance")
@click.option(
    "--noise",
    metavar="model|measured|LAYERS.h5",
    help="The model's noise, noise learnt from MEASURED, or that of a layers file.  [default: model; where this"
    " explains nothing, measured is tried too]",
)
@declared(RECONCILE, "split")
@click.option("--trace", is_flag=True, help="Print a line on stderr for each set of effects, as it is weighed.")
@json_option
@overwrite_option
def reconcile(model: str | None, measured: Path | None, output: Path, self: str | None, **options: Any) -> int:  # noqa: ANN401  of `_run`
    """Find where a simulation of MODEL and the recording MEASURED disagree, name the missing effect, and add it.

    The command compares each sample with the model's prediction, locates the
    disagreement, fits the known effects, scores them on held-out frames and pixels,
    and adds the effects that explain the disagreement. The verdict states whether
    any effect does. Recordings given with --also share the effects' parameters.
    docs/reference/verdicts.md explains the verdicts.

    In place of MODEL, a recording or a layers file is the reference: the scene as it was seen, with its errors. What
    changed since is named. With --self, the first frames of one recording are the reference of the others.

    Ctrl-C ends the search between two sets of effects: the folder is written with
    the best so far. A second Ctrl-C ends the command at once, and writes nothing.
    """
    share = None
    if self is not None:
        share, model, measured = _of_itself(self, model, measured)
    elif model is None or measured is None:
        raise click.UsageError("give MODEL and MEASURED, or --self and one recording")
    return _run(model, measured, output, share=share, **options)


def _of_itself(own: str, model: str | None, measured: Path | None) -> tuple[float, str, Path]:
    """The share or number of frames, and the recording twice: --self takes the argument after it as its value."""
    from tofmix.jobs.reference import SELF_SHARE

    given = [text for text in (own, model, None if measured is None else str(measured)) if text]
    try:
        share = float(own)
    except ValueError:
        share = SELF_SHARE
    else:
        given = given[1:]
    if len(given) != 1:
        raise click.UsageError("--self takes one recording, and no model")
    return share, given[0], Path(given[0])


def _run(
    model: str,
    measured: Path,
    output: Path,
    *,
    share: float | None,  # of the frames, or their number, with --self
    also: tuple[tuple[str, Path], ...],
    effects: str | None,
    noise: str | None,
    trace: bool,
    as_json: bool,
    overwrite: bool,
    **search: Any,  # noqa: ANN401  fields of the search's `Settings`
) -> int:
    """Reconcile files, print the outcome, and give the exit code."""
    from tofmix.errors import ExitCode
    from tofmix.io.model_file import load_model
    from tofmix.io.reconciliation import locked_folder, model_names, suggested_names
    from tofmix.io.recording.recording_file import open_recording
    from tofmix.jobs.estimate import learnt_sensor
    from tofmix.jobs.files import opened_recording
    from tofmix.jobs.reconcile import check_models, kinds_of, read_evidence, write_reconciliation
    from tofmix.jobs.reconcile import reconcile as run
    from tofmix.jobs.reference import REFERENCE
    from tofmix.reconciliation.settings import Settings
    from tofmix.reconciliation.words import summary_lines
    from tofmix.report.templates import check_extra

    def learnt() -> "Sensor":
        with open_recording(measured) as source:
            return learnt_sensor(source, reporter)

    check_extra()
    reporter = CommandReporter()
    names = None if effects is None else [name.strip() for name in effects.split(",") if name.strip()]
    kinds = kinds_of(names, reporter)
    files = ((model, measured), *also)
    settings = Settings(kinds=kinds, **search)
    with locked_folder(output, overwrite=overwrite, models=len(files)):
        reference = _reference(model, measured, share, reporter)
        rest = files if reference is None else also
        models = [] if reference is None else [(model, reference.model)]
        models += [(name, load_model(name)) for name, _ in rest]  # before recordings, which take longer to read
        check_models(models)
        recordings = []
        after = 0 if reference is None else reference.frames
        for (_, scene), (_, path) in zip(models, files, strict=True):
            with opened_recording(path, reporter) as file:
                time_s, temperature_c = file.read_time(), file.read_temperature()
                recordings.append(
                    (
                        scene,
                        read_evidence(scene, file, reporter, time_s=time_s, temperature_c=temperature_c, after=after),
                    )
                )
        with (
            Progress(len(kinds) * max(settings.max_effects, 1), "reconcile", "kind") as bar,
            _asked_to_stop() as stopped,
        ):
            reporter = _KindReporter(bar, len(kinds), stopped, trace=trace)
            result = run(recordings, settings, noise, learnt, reporter)
            bar.total = bar.done  # no other way is tried: the page is left
            bar.describe("reconcile: page")
            beside = {} if reference is None else {REFERENCE: reference.layers}
            write_reconciliation(result, files, output, overwrite=overwrite, beside=beside)
    if as_json:
        click.echo(json.dumps(result.as_dict(), indent=2, allow_nan=False))
        return ExitCode.INTERRUPTED if stopped() else ExitCode.DONE
    click.echo("\n".join(summary_lines(result)))
    more = suggested_names(len(files)) if result.has_advice else []
    written = ", ".join([*model_names(len(files))[1:], *more, "gap.json", "report.html"])
    click.echo(f"wrote        {output / 'model.toml'}, {written}")
    return ExitCode.INTERRUPTED if stopped() else ExitCode.DONE


def _reference(model: str, measured: Path, share: float | None, reporter: CommandReporter) -> "Reference | None":
    """What stands in place of a model; None where a model is given."""
    from tofmix.jobs.files import opened_recording
    from tofmix.jobs.reference import check_scene_file, first_frames, is_reference, longest_mm, reference_of_file

    if share is not None:
        return first_frames(measured, share, reporter, workers=default_workers())
    check_scene_file(model)
    if not is_reference(Path(model)):
        return None
    with opened_recording(measured, reporter) as other:
        longest = longest_mm(other)
    return reference_of_file(Path(model), reporter, workers=default_workers(), others_mm=longest)


@contextmanager
def _asked_to_stop() -> Iterator[Callable[[], bool]]:
    """Let the block look whether Ctrl-C was pressed; the second Ctrl-C has the meaning that it had before the block.

    No exception is raised: within a kernel that is compiled it would be lost.

    Yields
    ------
    callable
        Whether Ctrl-C was pressed.
    """
    before = signal.getsignal(signal.SIGINT)
    pressed = False

    def once(number: int, frame: FrameType | None) -> None:  # noqa: ARG001  as signals call it
        nonlocal pressed
        pressed = True
        signal.signal(number, before)
        os.write(sys.stderr.fileno(), _INTERRUPTED)

    signal.signal(signal.SIGINT, once)
    try:
        yield lambda: pressed
    finally:
        signal.signal(signal.SIGINT, before)


class _KindReporter(CommandReporter):
    """Counts kinds that were tried; where another way is tried, the bar gets longer. Ctrl-C stops the search."""

    def __init__(self, bar: Progress, kinds: int, stopped: Callable[[], bool], *, trace: bool) -> None:
        super().__init__(bar)
        self._progress, self._kinds = bar, kinds
        self._stopped, self._trace = stopped, trace

    def weighed(self, line: str) -> None:
        """Print the line with --trace."""
        if self._trace:
            with self.aside():
                click.echo(line, err=True)

    def is_stopped(self) -> bool:
        """Whether Ctrl-C was pressed."""
        return self._stopped()

    def progress(self, steps: int) -> None:
        """Move the bar."""
        if self._progress.done == self._progress.total:
            self._progress.total += self._kinds
        super().progress(steps)
