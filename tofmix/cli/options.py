"""What several commands share: options declared once, progress, and values from the shell."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm


class _Path(click.Path):
    """A path that the package checks itself, so that its refusals have their own exit codes."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ANN401  as click has it
        if not str(value):
            self.fail("the path is empty", param, ctx)
        return super().convert(value, param, ctx)


PATH = _Path(path_type=Path)

overwrite_option = click.option(
    "--overwrite", is_flag=True, help="Replace an output that is already there.", allow_from_autoenv=False
)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON on stdout, for scripts.", allow_from_autoenv=False
)


def default_workers() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def progress_bar(total: int, what: str, unit: str) -> "tqdm[Any]":
    """Return a bar on stderr; silent when stderr is no terminal."""
    return tqdm(total=total, desc=what, unit=unit, unit_scale=True, disable=None, leave=False)


def examples(text: str) -> Callable[[click.Command], click.Command]:
    """Add an examples section to a command's help, kept as it is written."""

    def add(command: click.Command) -> click.Command:
        command.epilog = "\b\nExamples:\n" + "\n".join("  " + line for line in text.strip().splitlines())
        return command

    return add
