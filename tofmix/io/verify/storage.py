"""Storage of a dataset: whether damage would be noticed, and whether it is complete."""

import math
from pathlib import Path

import h5py

from tofmix.io.guard import guard
from tofmix.io.guard.unpacking import FLETCHER32
from tofmix.io.verify.findings import Findings


def check_storage(dataset: h5py.Dataset, name: str, path: Path, findings: Findings, *, ours: bool) -> None:
    """Check that each chunk has a checksum, and that none is missing; no data are read.

    Parameters
    ----------
    dataset : h5py.Dataset
        The dataset.
    name : str
        Its name.
    path : Path
        Its file.
    findings : Findings
        Receives faults of a tofmix file, or notes on another program's.
    ours : bool
        Whether the file is marked as of a tofmix format.
    """
    with guard.reading(path, name):
        if dataset.chunks is None:
            _say(findings, name, "without checksum; a flipped bit would not be noticed", fault=False)
            return
        plist = dataset.id.get_create_plist()
        codes = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
        if FLETCHER32 not in codes:
            _say(findings, name, "without checksum; a flipped bit would not be noticed", fault=False)
            return
        missing, unguarded = _count_chunks(dataset, 1 << codes.index(FLETCHER32))
    if missing:
        _say(findings, name, f"{missing} stored chunks are missing and would be read as no value", fault=ours)
    if unguarded:
        _say(findings, name, f"{unguarded} stored chunks have no checksum, the others have", fault=True)


def _count_chunks(dataset: h5py.Dataset, bit: int) -> tuple[int, int]:
    """Chunks that are missing, and chunks that were stored without the filter of a bit of the mask."""
    expected = math.prod(-(-n // step) for n, step in zip(dataset.shape, dataset.chunks, strict=True))
    found = [0, 0]

    def count(info: h5py.h5d.StoreInfo) -> None:
        found[0] += 1
        found[1] += bool(info.filter_mask & bit)

    dataset.id.chunk_iter(count)
    return expected - found[0], found[1]


def _say(findings: Findings, name: str, text: str, *, fault: bool) -> None:
    if fault:
        findings.add(name, text)
    else:
        findings.notes.append(f"{name}: {text}")
