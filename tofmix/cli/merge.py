"""``tofmix merge``: the parts of a sharded estimate in, a layers file out."""

import json
from pathlib import Path

import click

from tofmix.cli.options import HDF5_PATH, PATH, examples, json_option, overwrite_option
from tofmix.cli.reporter import CommandReporter


@examples(
    """
tofmix merge long.layers.*.part -o long.layers.h5
"""
)
@click.command(short_help="Join the parts of estimate --shard.")
@click.argument("parts", type=PATH, nargs=-1, required=True)
@click.option("-o", "--output", type=HDF5_PATH, required=True, help="Layers file to write.")
@json_option
@overwrite_option
def merge(parts: tuple[Path, ...], output: Path, *, as_json: bool, overwrite: bool) -> None:
    """Join PARTS, the files that `tofmix estimate --shard I/N` wrote of one recording.

    The layers file has the same bytes as the result of a single run. Missing or duplicate parts, and parts of another
    run, are refused. The parts are kept.
    """
    from tofmix.cli.estimate_runs import describe
    from tofmix.io.layers.journal import WHOLE
    from tofmix.jobs.estimate import merge_files

    line, values = describe(*merge_files(parts, output, CommandReporter(), overwrite=overwrite), WHOLE)
    click.echo(json.dumps({"output": str(output), **values}) if as_json else line)
