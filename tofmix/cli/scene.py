"""``tofmix scene``: a recording, its layers or its surfaces in; a model of the scene out."""

import json
from pathlib import Path

import click

from tofmix.cli.options import PATH, default_workers, examples, json_option, overwrite_option
from tofmix.cli.reporter import CommandReporter


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
