"""``tofmix warmup``: compiles every kernel into the cache, for container images."""

import json

import click

from tofmix.cli.options import examples, json_option
from tofmix.errors import StorageError
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

    Later runs compile nothing, on this machine and on others of its class of
    processors. The command prints the folder, the number of kernels and their size.
    NUMBA_CACHE_DIR sets another folder, for later runs too; without it the folder is
    beside the installed package, or in the user's cache if that is read-only.
    """
    from tofmix.compiled.kept import CANNOT_KEEP, gather
    from tofmix.io.model_file import load_model
    from tofmix.pipeline.kernels import compile_all
    from tofmix.reconciliation.workflow import warm_up

    compile_all()
    warm_up(load_model("three-boards"))
    kept = gather()
    if kept is None:
        raise StorageError(CANNOT_KEEP)
    if as_json:
        click.echo(json.dumps({"folder": str(kept.folder), "kernels": kept.kernels, "bytes": kept.size_bytes}))
    else:
        size = f"{kept.size_bytes / 1e6:.1f} MB"
        click.echo(f"{kept.folder}: {counted(kept.kernels, 'compiled kernel')}, {size}")
