"""Faults that `tofmix verify` finds, gathered over the blocks of a file: one line for each fault."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tofmix.arrays import BoolArray
from tofmix.errors import BadInputError


@dataclass(slots=True)
class Fault:
    """One fault of a dataset; `count` places have it, `first` is the first of them, empty where it is of the whole."""

    name: str
    text: str
    first: str = ""
    count: int = 0


@dataclass(slots=True)
class Findings:
    """Checked datasets, faults and notes.

    Parameters
    ----------
    kind : str
        Kind of the file.
    checked : int
        Datasets that were read whole.
    faults : dict
        Faults by dataset and rule.
    notes : list of str
        Remarks that are not faults.
    """

    kind: str
    checked: int = 0
    faults: dict[tuple[str, str], Fault] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, text: str, *, first: str = "", count: int = 1) -> None:
        """Add places with a fault; the first report names the first place."""
        fault = self.faults.setdefault((name, text), Fault(name, text, first))
        fault.count += count

    def add_error(self, error: BadInputError, path: object, *, first: str = "") -> None:
        """Add an error of reading, without the name of the file."""
        text = str(error).removeprefix(f"{path}: ")
        name, _, reason = text.partition(": ")
        self.add(name if reason else "file", reason or text, first=first)

    def add_broken(
        self, name: str, text: str, broken: BoolArray, dims: tuple[str, ...], offset: tuple[int, ...]
    ) -> None:
        """Add the places of a block where a rule is broken; `offset` is where the block begins."""
        count = int(np.count_nonzero(broken))
        if count:
            place = np.argwhere(broken)[0]
            where = ", ".join(f"{dim} {int(k) + o}" for dim, k, o in zip(dims, place, offset, strict=True))
            self.add(name, f"broken: {text}", first=where, count=count)

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.faults

    def lines(self) -> list[str]:
        """One line a fault."""
        return [f"{fault.name}: {_described(fault)}" for fault in self.faults.values()]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "kind": self.kind,
            "ok": self.ok,
            "datasets_read": self.checked,
            "faults": [
                {"dataset": f.name, "fault": f.text, "first": f.first, "count": f.count} for f in self.faults.values()
            ],
            "notes": list(self.notes),
        }


def _described(fault: Fault) -> str:
    if not fault.first:
        return fault.text
    more = f" and {fault.count - 1:,} more" if fault.count > 1 else ""
    return f"{fault.text} ({fault.first}{more})"
