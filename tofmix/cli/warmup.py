"""``tofmix warmup``: compiles every kernel into the cache, for container images."""

import json

import click

from tofmix.cli.options import examples, json_option
from tofmix.wording import counted


@examples(
    """
tofmix warmup
NUMBA_CACHE_DIR=/opt/tofmix-kernels tofmix warmup
"""
)
@click.command(short_help="Compile all kernels ahead, for container images.")
@json_option
def warmup(*, as_json: bool) -> None:
    """Compile the kernels of all commands and options, and store them.

    Later runs compile nothing. The command prints the folder: in the package, or in
    the user's cache if the package is read-only. NUMBA_CACHE_DIR sets another
    folder, for later runs too.
    """
    from tofmix.cli.compiling import announced
    from tofmix.compiled.jit import cache_folder
    from tofmix.io.model_file import load_model
    from tofmix.pipeline.kernels import compile_all
    from tofmix.reconciliation.warm_up import warm_up

    with announced():
        compile_all()
        warm_up(load_model("three-boards"))
    count = sum(1 for _ in cache_folder().rglob("*.nbc"))
    line = f"{cache_folder()}: {counted(count, 'compiled kernel')}"
    click.echo(json.dumps({"folder": str(cache_folder()), "kernels": count}) if as_json else line)
