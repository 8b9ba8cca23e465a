"""Whether files are whole and keep their contract: every chunk read, every rule applied, block by block.

`verify` takes a recording, a layers file, a surfaces file, a model, a sensor file or a reconciliation's folder. It
reports faults and never raises for them.
"""

import itertools
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tofmix.errors import BadInputError
from tofmix.invariants import layer_rules
from tofmix.io import hdf5
from tofmix.io.atomic.storage import read_text
from tofmix.io.guard import guard
from tofmix.io.layers import layers_file
from tofmix.io.layers.layers_file import LayersFile
from tofmix.io.model_file import load_model
from tofmix.io.reconciliation import FILES, model_names
from tofmix.io.recording.recording_file import RecordingFile
from tofmix.io.surfaces.fields import FORMAT as SURFACES_FORMAT
from tofmix.io.surfaces.surfaces_file import SurfacesFile
from tofmix.io.verify.findings import Findings
from tofmix.io.verify.recording import verify_recording
from tofmix.io.verify.storage import check_storage
from tofmix.io.verify.surfaces import verify_surfaces
from tofmix.layers import LAYER_FIELDS, OPTIONAL_FIELDS
from tofmix.suspicion.rules import suspect_rules
from tofmix.wording import counted

_VERDICTS = ("agree", "explained", "partly_explained", "unexplained")
_PLACE = ("window", "row", "col")


def verify(path: Path) -> Findings:
    """Check a file, or a folder that `reconcile` wrote.

    Parameters
    ----------
    path : Path
        The file or folder.

    Returns
    -------
    Findings
        Its faults; also for a missing or unreadable file.
    """
    findings = Findings("unknown")
    try:
        if path.is_dir():
            _verify_folder(path, findings)
        elif path.suffix == ".toml":
            findings.kind = "model"
            load_model(str(path))
        else:
            _verify_hdf5(path, findings)
    except BadInputError as error:
        findings.add_error(error, path)
    return findings


def _verify_hdf5(path: Path, findings: Findings) -> None:
    with guard.open_for_reading(path) as root:
        with guard.reading(path, "format"):
            kind = hdf5.text_attribute(root, "format")
        if kind == layers_file.FORMAT:
            findings.kind = "layers"
            _verify_layers(root, path, findings)
        elif kind == SURFACES_FORMAT:
            findings.kind = "surfaces"
            with guard.reading(path, "header"):
                hdf5.check_format(root, path, kind=SURFACES_FORMAT, required=True)
                surfaces = SurfacesFile(root, path)
            verify_surfaces(root, surfaces, findings)
        else:
            findings.kind = "recording"
            with guard.reading(path, "header"):
                hdf5.check_format(root, path, kind="tofmix-recording", required=False)
                recording = RecordingFile(root, path)
            verify_recording(root, recording, findings, ours=kind is not None)


def _verify_layers(root: h5py.File, path: Path, findings: Findings) -> None:
    with guard.reading(path, "header"):
        hdf5.check_format(root, path, kind=layers_file.FORMAT, required=True)
        layers = LayersFile(root, path)
    units = {spec.name: spec.units for spec in (*LAYER_FIELDS, *OPTIONAL_FIELDS) if spec.name in layers.names}
    for name, unit in (units | {"window_start": "1", "window_stop": "1"}).items():
        with guard.reading(path, name):
            found = hdf5.text_attribute(root[name], "units")
            if found != unit:
                findings.add(name, f"units {found!r}, expected {unit!r}")
            check_storage(root[name], name, path, findings, ours=True)
    _check_windows(layers, findings)
    for windows, rows in _blocks(layers):
        _check_block(layers, windows, rows, findings)
    findings.checked += len(units) + 2  # and the windows' ends


def _check_windows(layers: LayersFile, findings: Findings) -> None:
    starts, stops = (bounds.astype(np.float64) for bounds in (layers.window_start, layers.window_stop))
    if (stops <= starts).any() or (np.diff(starts) <= 0).any() or len(np.unique(stops - starts)) > 1:
        findings.add("window_start", "windows must ascend, each of the same number of frames")
    options = layers.provenance.options
    window = options.get("window")
    if isinstance(window, int) and (stops - starts != window).any():
        findings.add("window_stop", f"windows are not of {counted(window, 'frame')}, as the options say")
    if len(layers.provenance.source_sha256) != 64:  # noqa: PLR2004  digits of SHA-256
        findings.notes.append("no checksum of the recording that the layers were made from")


def _blocks(layers: LayersFile) -> Iterator[tuple[slice, slice]]:
    """Windows and rows of whole stored chunks, so that each is unpacked once and memory stays small."""
    step = layers.step
    for window, row in itertools.product(range(0, layers.shape[0], step[0]), range(0, layers.shape[1], step[1])):
        yield slice(window, min(window + step[0], layers.shape[0])), slice(row, min(row + step[1], layers.shape[1]))


def _check_block(layers: LayersFile, windows: slice, rows: slice, findings: Findings) -> None:
    where = f"from window {windows.start}, row {rows.start} on"
    try:
        block = layers.read_block(windows, rows)
    except BadInputError as error:
        for name in layers.names:
            try:
                layers.read_dataset(name, windows, rows)
            except BadInputError as damaged:
                findings.add_error(damaged, layers.path, first=where)
        if findings.ok:
            findings.add_error(error, layers.path, first=where)
        return
    frames = layers.window_stop[windows].astype(np.int64) - layers.window_start[windows].astype(np.int64)
    offset = (windows.start, rows.start, 0)
    made = layers.provenance
    rules = layer_rules(block, frames, circle_mm=made.unambiguous_range_mm, samples_a_frame=made.samples_a_frame)
    for rule in (*rules, *suspect_rules(block)):
        findings.add_broken(rule.name, rule.text, rule.broken, _PLACE, offset)


def _verify_folder(folder: Path, findings: Findings) -> None:
    findings.kind = "reconciliation"
    for name in (*model_names(1), *FILES):
        if not (folder / name).is_file():
            findings.add(name, "missing; the output of reconcile is incomplete")
    if not findings.ok:
        return
    load_model(str(folder / "model.toml"))
    gap = _read_gap(folder / "gap.json")
    if gap.get("verdict") not in _VERDICTS:
        findings.add("gap.json", f"verdict {gap.get('verdict')!r}, expected one of {', '.join(_VERDICTS)}")
    for key in ("effects", "where", "candidates", "aliases", "panel"):
        if not isinstance(gap.get(key), list):
            findings.add("gap.json", f"{key}: expected a list")
    sizes = gap.get("gap")
    for key in ("before", "after", "floor"):
        value = sizes.get(key) if isinstance(sizes, dict) else None
        if not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
            findings.add("gap.json", f"gap: {key}: expected a number of at least 0, got {value!r}")


def _read_gap(path: Path) -> dict[str, Any]:
    try:
        gap = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise BadInputError(f"{path}: not JSON ({error})") from error
    if not isinstance(gap, dict):
        raise BadInputError(f"{path}: expected an object")
    return gap
