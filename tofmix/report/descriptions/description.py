"""A description of any file: sections of named values, warnings, and their text for the terminal."""

import textwrap
from dataclasses import dataclass
from typing import Any

from tofmix.report.summary.findings import Finding
from tofmix.report.summary.tables import printable
from tofmix.wording import finite_or_none, number

_NAME_WIDTH = 26  # characters of the column of names
_TEXT_WIDTH = 100  # characters of a line
_LONGEST_SENTENCE = 1000  # characters of a sentence from a file before it is cut
_LONGEST_VALUE = 120  # characters of a value from a file before it is cut
_SENTENCES = ("found",)
"""Names of values that are sentences, and are not cut."""
_OF_SENTENCES = ("sources", "next_steps")
"""Sections whose values are sentences."""

Value = str | int | float | bool | None | list[float] | list[dict[str, Any]]
Section = dict[str, Value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """A file in words and numbers."""

    kind: str  # ``recording``, ``layers``, ``surfaces``, ``model``, ``sensor``, ``source`` or ``reconciliation``
    name: str  # the file, as given
    sections: dict[str, Section]  # names of values within each section carry their units; None means unknown
    warnings: tuple[Finding, ...]  # what to be wary of
    # The noise curve with all its numbers, as a table of a model file, for the terminal alone; empty without one.
    table: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the same for JSON: None for numbers that are not finite."""
        warnings = [{"code": finding.code, "text": finding.line} for finding in self.warnings]
        sections = {title: {k: finite_or_none(v) for k, v in part.items()} for title, part in self.sections.items()}
        return {"kind": self.kind, "file": self.name, **sections, "warnings": warnings}


def format_description(description: Description) -> str:
    """Format a description for the terminal, without a newline at the end."""
    lines = [f"{printable(description.name)}: {description.kind}"]
    for title, section in description.sections.items():
        lines += ["", title.replace("_", " ")]
        for key, value in section.items():
            lines += _wrapped(value) if title in _OF_SENTENCES else _lines(key, value)
    if description.table:
        lines += ["", "noise curve, to paste into a model", description.table.rstrip()]
    if description.warnings:
        lines.append("")
    lines += [f"warning: {finding.line}" for finding in description.warnings]
    return "\n".join(lines)


def _wrapped(value: Value) -> list[str]:
    return textwrap.wrap(
        printable(str(value), _LONGEST_SENTENCE), _TEXT_WIDTH, initial_indent="  - ", subsequent_indent="    "
    )


def _lines(key: str, value: Value) -> list[str]:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        rows = (", ".join(f"{k} {_shown(v)}" for k, v in item.items()) for item in value)
        return [f"  {key} {number}: {printable(row, 160)}" for number, row in enumerate(rows, 1)]
    longest = _LONGEST_SENTENCE if key in _SENTENCES else _LONGEST_VALUE
    return [f"  {printable(key, _NAME_WIDTH):<{_NAME_WIDTH}} {printable(_shown(value), longest)}"]


def _shown(value: object) -> str:
    if value is None:
        return "not known"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return " ".join(_shown(item) for item in value) or "none"
    return number(value, ".9g") if isinstance(value, float) else str(value)
