"""Faults that `tofmix verify` finds, gathered over the blocks of a file: one line for each fault.

`check_fields` holds the datasets of any file against their declarations: units, checksums, missing chunks.
"""

import itertools
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tofmix.arrays import BoolArray
from tofmix.errors import BadInputError
from tofmix.io import hdf5
from tofmix.io.guard import guard
from tofmix.io.guard.structure_rules import FLETCHER32, filters_of
from tofmix.io.schema import Field


@dataclass(slots=True)
class Fault:
    """One fault of a dataset; `count` places have it, `first` is the first of them, empty where it is of the whole."""

    name: str
    text: str
    first: str = ""
    count: int = 0


@dataclass(slots=True)
class Findings:
    """Checked datasets, faults and notes."""

    kind: str  # kind of the file
    checked: int = 0  # datasets that were read whole
    faults: dict[tuple[str, str], Fault] = field(default_factory=dict)  # faults by dataset and rule
    notes: list[str] = field(default_factory=list)  # remarks that are not faults

    def add(self, name: str, text: str, *, first: str = "", count: int = 1) -> None:
        """Add places with a fault; the first report names the first place."""
        fault = self.faults.setdefault((name, text), Fault(name, text, first))
        fault.count += count

    def add_error(self, error: BadInputError, path: object, *, first: str = "") -> None:
        """Add an error of reading, without the name of the file."""
        text = str(error).removeprefix(f"{path}: ")
        name, _, reason = text.partition(": ")
        self.add(name if reason else "file", reason or text, first=first)

    @contextmanager
    def errors(self, path: object, *, first: str = "") -> Iterator[None]:
        """Add the error of reading that ends the block."""
        try:
            yield
        except BadInputError as error:
            self.add_error(error, path, first=first)

    def note(self, name: str, text: str, *, fault: bool) -> None:
        """Add a fault of a whole dataset, or a remark."""
        if fault:
            self.add(name, text)
        else:
            self.notes.append(f"{name}: {text}")

    def add_broken(
        self, name: str, text: str, broken: BoolArray, dims: tuple[str, ...], offset: tuple[int, ...]
    ) -> None:
        """Add the places of a block where a rule is broken; `offset` is where the block begins."""
        count = int(np.count_nonzero(broken))
        if count:
            place = np.argwhere(broken)[0]
            where = ", ".join(f"{dim} {int(k) + o}" for dim, k, o in zip(dims, place, offset, strict=True))
            self.add(name, f"broken: {text}", first=where, count=count)

    def check_source(self, sha256: str, what: str) -> None:
        """Note that results lack the checksum of the file that they were made from."""
        if len(sha256) != 64:  # noqa: PLR2004  digits of SHA-256
            self.notes.append(f"no checksum of the {what} were made from")

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


def check_fields(
    root: h5py.File, specs: Iterable[Field], path: Path, findings: Findings, *, ours: bool = True, group: str = ""
) -> None:
    """Check units and storage of the datasets that are there; no data are read.

    Files of other programs, not `ours`, need not have units, and get notes in place of faults. `group` is where the
    datasets are, as in ``truth/``.
    """
    for spec in specs:
        name = f"{group}{spec.name}"
        with guard.reading(path, name):
            if name not in root:
                continue
            dataset = root[name]
            found = hdf5.text_attribute(dataset, "units")
            if found != spec.units and (ours or found is not None):
                findings.add(name, f"units {found!r}, expected {spec.units!r}")
            check_storage(dataset, name, findings, ours=ours)


def check_storage(dataset: h5py.Dataset, name: str, findings: Findings, *, ours: bool) -> None:
    """Check that each chunk of a dataset has a checksum, and that none is missing."""
    codes = filters_of(dataset.id)
    if FLETCHER32 not in codes:
        findings.note(name, "without checksum; a flipped bit would not be noticed", fault=False)
        return
    missing, unguarded = _count_chunks(dataset, 1 << codes.index(FLETCHER32))
    if missing:
        findings.note(name, f"{missing} stored chunks are missing and would be read as no value", fault=ours)
    if unguarded:
        findings.add(name, f"{unguarded} stored chunks have no checksum, the others have")


def _count_chunks(dataset: h5py.Dataset, bit: int) -> tuple[int, int]:
    """Chunks that are missing, and chunks that were stored without the filter of a bit of the mask."""
    expected = math.prod(-(-n // step) for n, step in zip(dataset.shape, dataset.chunks, strict=True))
    found = [0, 0]

    def count(info: h5py.h5d.StoreInfo) -> None:
        found[0] += 1
        found[1] += bool(info.filter_mask & bit)

    dataset.id.chunk_iter(count)
    return expected - found[0], found[1]


def blocks(shape: tuple[int, ...], step: tuple[int, int]) -> Iterator[tuple[slice, slice]]:
    """Parts of the first two axes, each of whole steps: a stored chunk is unpacked once, and memory stays small."""
    for first, second in itertools.product(range(0, shape[0], step[0]), range(0, shape[1], step[1])):
        yield slice(first, min(first + step[0], shape[0])), slice(second, min(second + step[1], shape[1]))
