"""``tofmix verify``: whether files are whole and keep their contract."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import PATH, examples, json_option, note
from tofmix.errors import ExitCode
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.verify import Findings


@examples(
    """
tofmix verify boards.h5 boards.layers.h5 boards.surfaces.h5
tofmix verify layers/*.layers.h5 --json
tofmix verify gap
"""
)
@click.command(short_help="Check that files are whole and consistent.")
@click.argument("files", type=PATH, nargs=-1, required=True)
@json_option
def verify(files: tuple[Path, ...], as_json: bool) -> ExitCode:
    """Check FILES: recordings, layers, surfaces, models, or folders that tofmix reconcile wrote.

    Reads every value and compares every checksum. Checks dimensions, types, units and the rules of every result: shares
    sum to 1, ranges ascend, values after the first n_modes are NaN, statuses agree with the layers, and surfaces have
    the stated number of layers. Prints one line for each fault. Exit code 0: no fault; 3: a fault; 5: a fault in some
    of several files.
    """
    from tofmix.io.verify import verify as verify_file

    found = {}
    for path in files:
        found[path] = verify_file(path)
        if not as_json:
            _show(path, found[path])
    if as_json:
        listed = [{"file": str(path), **findings.as_dict()} for path, findings in found.items()]
        click.echo(json.dumps({"ok": all(f.ok for f in found.values()), "files": listed}, indent=2))
    wrong = sum(not findings.ok for findings in found.values())
    if not wrong:
        return ExitCode.DONE
    return ExitCode.BAD_INPUT if wrong == len(found) else ExitCode.SOME_FAILED


def _show(path: Path, findings: "Findings") -> None:
    for line in findings.lines():
        click.echo(f"{path}: {_printable(line)}")
    for text in findings.notes:
        note(f"{path}: {_printable(text)}")
    if findings.ok:
        read = f", {counted(findings.checked, 'dataset')} read" if findings.checked else ""
        click.echo(f"{path}: {findings.kind}{read}; no fault")


def _printable(text: str) -> str:
    """One line without control characters: names in a file are not ours."""
    return "".join(c if c.isprintable() else "?" for c in text)
