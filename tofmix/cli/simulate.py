"""``tofmix simulate``: a model in, a synthetic recording out; ``tofmix scene``: from what was recorded to a model."""

import json
from pathlib import Path

import click

from tofmix.cli.options import HDF5_PATH, PATH, default_workers, examples, json_option, overwrite_option
from tofmix.cli.reporter import CommandReporter
from tofmix.wording import counted


def _list_models(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if not wanted or context.resilient_parsing:
        return
    from tofmix.simulation import BUILTIN_MODELS, builtin_description

    for name in BUILTIN_MODELS:
        click.echo(f"{name:14s} {builtin_description(name)}")
    context.exit()


@examples(
    """
tofmix simulate three-boards -o boards.h5
tofmix simulate three-boards --averaged -o averaged.h5
tofmix simulate corridor --print-model > my_scene.toml
tofmix simulate my_scene.toml --explain
tofmix simulate my_scene.toml -o my_scene.h5 --frames 500 --seed 7
tofmix simulate my_scene.toml -o my_scene.h5 --repeat 3
"""
)
@click.command(short_help="Write a synthetic recording of a model scene.")
@click.argument("model")
@click.option("-o", "--output", type=HDF5_PATH, help="Recording to write.")
@click.option("--frames", type=click.IntRange(1), help="Frames.  [default: the model's]")
@click.option("--seed", type=click.IntRange(0), help="Seed; the same seed gives the same file.  [default: the model's]")
@click.option(
    "--averaged",
    is_flag=True,
    allow_from_autoenv=False,
    help="Write the means that the camera's on-board averaging returns.",
)
@click.option(
    "--print-model", is_flag=True, allow_from_autoenv=False, help="Print the model as TOML, as a start for your own."
)
@click.option(
    "--explain",
    is_flag=True,
    allow_from_autoenv=False,
    help="Describe the simulation in words, effect by effect, and write nothing.",
)
@click.option(
    "--repeat",
    type=click.IntRange(1, 999),
    metavar="N",
    help="Write N recordings, OUTPUT_001.h5 and so on, with ascending seeds.",
)
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_list_models,
    allow_from_autoenv=False,
    help="List the built-in models.",
)
@json_option
@overwrite_option
def simulate(
    model: str,
    output: Path | None,
    frames: int | None,
    seed: int | None,
    averaged: bool,
    print_model: bool,
    explain: bool,
    repeat: int | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Write a synthetic recording of MODEL, a TOML file or a built-in model.

    A model describes a camera and the boards in its view. Each sample shows a surface, with the probability of its
    share of the pixel's beam; or no return, or a random value. The camera's noise at this range is added. A model may
    list effects of real cameras (docs/reference/effects.md). The recording contains the true surfaces.
    """
    if as_json and (print_model or explain):
        raise click.UsageError("--json describes written recordings; leave out --print-model and --explain")
    if print_model:
        from tofmix.io.model_file import load_model_text

        click.echo(load_model_text(model), nl=False)
        return
    from tofmix.io.model_file import load_model

    if output is None and not explain:
        raise click.UsageError("Missing option '-o' / '--output'.")
    scene = load_model(model).with_recording(frames=frames, seed=seed)
    if output is None or explain:
        from tofmix.simulation.model_toml import explain as explained

        click.echo(explained(scene))
        return

    from tofmix.io.storage import check_output, locked
    from tofmix.jobs.simulate import Simulation

    outputs = [output] if repeat is None else [_numbered(output, k) for k in range(1, repeat + 1)]
    for path in outputs:
        check_output(path, overwrite=overwrite, inputs=(Path(model),))
    n_frames, rows, cols = scene.recording.frames, scene.sensor.rows, scene.sensor.cols
    for number, path in enumerate(outputs, start=scene.recording.seed):
        with locked(path, overwrite=overwrite, inputs=(Path(model),)):
            seeded = scene.with_recording(seed=number)
            made = Simulation.of(seeded, model, averaged=averaged, threads=default_workers())
            made.write(path, model, CommandReporter(), overwrite=overwrite)
        said = {"output": str(path), "frames": n_frames, "rows": rows, "cols": cols, "seed": number}
        words = counted(n_frames, "averaged frame" if averaged else "frame")
        line = f"{path}: {words} of {rows} x {cols} pixels, seed {number}"
        click.echo(json.dumps(said | {"averaged": averaged}) if as_json else line)


def _numbered(output: Path, number: int) -> Path:
    return output.with_name(f"{output.stem}_{number:03d}{output.suffix}")


@examples(
    """
tofmix scene boards.h5 -o scene.toml
tofmix scene boards.h5 --planes -o scene.toml
tofmix scene boards.layers.h5 --planes -o scene.toml
tofmix scene fine.surfaces.h5 --planes -o scene.toml
tofmix simulate scene.toml -o again.h5
tofmix reconcile scene.toml another.h5 -o gap
"""
)
@click.command(short_help="Write what a recording saw as a model.")
@click.argument("source", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="Model to write, a TOML file.")
@click.option(
    "--planes",
    is_flag=True,
    allow_from_autoenv=False,
    help="Write each plane as a rectangle, for editing. Without it, the layers themselves are the scene.",
)
@click.option(
    "--window", type=click.IntRange(0), default=0, show_default=True, help="Window of layers or surfaces, from 0."
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    help="Threads of the estimate of a recording; their number changes no result.  [default: all cores]",
)
@json_option
@overwrite_option
def scene(
    source: Path, output: Path, planes: bool, window: int, workers: int | None, as_json: bool, overwrite: bool
) -> None:
    """Write the scene that SOURCE saw as a model, a TOML file that simulate and reconcile read.

    SOURCE is a recording, which is estimated as tofmix estimate does; or a layers file. The model's [scene] names the
    layers, which are written beside it: each pixel keeps its ranges, shares, amplitudes and widths as measured. Its
    surfaces have the numbers of tofmix surfaces.

    With --planes, each plane becomes a [[surface]], the least rectangle about its outline, and SOURCE may also be a
    surfaces file. The camera and its noise become [sensor] and [sensor.noise]. Smooth surfaces that are no planes are
    left out and counted, and so are the pixels in which a rectangle changes a share.
    """
    from tofmix.jobs.scene import write_measured, write_scene

    made = (write_scene if planes else write_measured)(
        source,
        output,
        CommandReporter(),
        window=window,
        workers=workers or default_workers(),
        overwrite=overwrite,
    )
    click.echo(json.dumps({"output": str(output), **made.values}) if as_json else f"{output}: {made.words}")
