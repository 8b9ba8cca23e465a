"""``tofmix reconcile``: a model and a measurement in, the missing effects out."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import PATH, examples, json_option, overwrite_option, progress_bar

if TYPE_CHECKING:
    from tofmix.reconcile.evidence import Evidence
    from tofmix.reconcile.workflow import Reconciliation
    from tofmix.simulation.model import Model

_MOST_SAMPLES = 1 << 28


@examples(
    """
tofmix reconcile my_scene.toml measured.h5 -o gap
tofmix reconcile my_scene.toml measured.h5 -o gap --effects wiggling,range_offset,surface_pose
tofmix simulate gap/model.toml -o refined.h5
"""
)
@click.command(short_help="Name what a simulation lacks against a measurement.")
@click.argument("model")
@click.argument("measured", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="Folder for model.toml, gap.json and report.html.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of every random draw.")
@click.option("--effects", metavar="A,B,...", help="Kinds of effects that are tried.  [default: all]")
@click.option(
    "--max-effects", type=click.IntRange(0, 10), default=3, show_default=True, help="Most effects that are added."
)
@click.option(
    "--alpha", type=click.FloatRange(0, 0.5, min_open=True), default=0.01, show_default=True,
    help="Level of the tests, corrected for all that is looked at.",
)  # fmt: skip
@click.option(
    "--tolerance", type=click.FloatRange(0, 1), default=0.1, show_default=True,
    help="Errors of the model that are taken as right: of poses, in sigma; of sigma, a tenth of it.",
)  # fmt: skip
@click.option(
    "--split", type=click.Choice(["frames,pixels", "frames", "pixels"]), default="frames,pixels", show_default=True,
    help="What is held out of the fits.",
)  # fmt: skip
@json_option
@overwrite_option
def reconcile(
    model: str,
    measured: Path,
    output: Path,
    seed: int,
    effects: str | None,
    max_effects: int,
    alpha: float,
    tolerance: float,
    split: str,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Find where a simulation of MODEL and the recording MEASURED disagree, name the missing effect, and add it.

    Compares each sample with the model's own prediction, locates the disagreement,
    fits the known effects, scores them on frames and pixels that no fit has seen,
    and adds those that explain it. Says so where none does. The page
    docs/reconcile.md explains the output.
    """
    from tofmix.io.model_file import load_model
    from tofmix.io.reconciliation import claimed_folder
    from tofmix.reconcile.add import Settings
    from tofmix.reconcile.words import summary_lines
    from tofmix.reconcile.workflow import reconcile as run

    kinds = _kinds(effects)
    settings = Settings(kinds=kinds, max_effects=max_effects, alpha=alpha, tolerance=tolerance, split=split, seed=seed)
    with claimed_folder(output, overwrite=overwrite):
        scene = load_model(model)
        evidence = _read(scene, measured)
        with progress_bar(len(kinds) * max(max_effects, 1), "reconcile", "kind") as bar:

            def tick(_: str) -> None:
                bar.update(1)

            result = run(scene, evidence, settings, tick)
        _write(result, model, measured, output, overwrite)
    if as_json:
        click.echo(json.dumps(result.as_dict(), indent=2, allow_nan=False))
        return
    click.echo("\n".join(summary_lines(result)))
    click.echo(f"wrote        {output / 'model.toml'}, gap.json, report.html")


def _kinds(effects: str | None) -> tuple[str, ...]:
    from tofmix.errors import UsageError
    from tofmix.reconcile.name import KINDS
    from tofmix.toml_table import nearest

    if effects is None:
        return KINDS
    wanted = [name.strip() for name in effects.split(",") if name.strip()]
    for name in wanted:
        if name not in KINDS:
            raise UsageError(f'--effects: "{name}" is not an effect{nearest(name, KINDS)}')
    if not wanted:
        raise UsageError("--effects: no effect is named")
    return tuple(kind for kind in KINDS if kind in wanted)


def _read(scene: "Model", measured: Path) -> "Evidence":
    from tofmix.errors import BadInputError
    from tofmix.io.recording_file import open_recording
    from tofmix.reconcile.evidence import make_evidence

    with open_recording(measured) as file:
        samples = math.prod(file.shape)
        if samples > _MOST_SAMPLES:
            raise BadInputError(
                f"{measured}: range: {samples:,} samples; reconcile holds them all in memory, {_MOST_SAMPLES:,} at most"
            )
        every = slice(0, None)
        try:
            return make_evidence(scene, file.read_range(every, every), time_s=file.read_time())
        except BadInputError as error:
            raise BadInputError(f"{measured}: {error}") from error


def _write(result: "Reconciliation", model: str, measured: Path, output: Path, overwrite: bool) -> None:
    from tofmix.io.reconciliation import write_folder
    from tofmix.reconcile.words import effect_tables
    from tofmix.reconcile.workflow import maps_of
    from tofmix.report.gap_page import render_gap

    text = result.model.text.rstrip("\n") + "\n"
    tables = effect_tables(result)
    text = f"{text}\n{tables}" if tables else text
    maps = {}
    for effect in (*result.model.effects, *(named.effect for named in result.named)):
        maps.update(maps_of(effect))
    page = render_gap(result, source=measured.name)
    inputs = tuple(path for path in (Path(model), measured) if path.exists())
    write_folder(
        output, model_text=text, maps=maps, gap=result.as_dict(), page=page, overwrite=overwrite, inputs=inputs
    )
