"""Whether files are whole and keep their contract: every chunk read, every rule applied, block by block.

`verify` takes a recording, a layers file, a surfaces file, a model, a sensor file or a reconciliation's folder. It
reports faults and never raises for them.
"""

from pathlib import Path

import h5py
import numpy as np

from tofmix.errors import BadInputError
from tofmix.invariants import layer_rules
from tofmix.io import hdf5
from tofmix.io.guard import guard
from tofmix.io.layers.layers_file import LayersFile
from tofmix.io.model_file import load_model
from tofmix.io.reconciliation import FILES, GAP, gap_faults, model_names, parse_gap
from tofmix.io.recording.recording_file import RecordingFile
from tofmix.io.result_file import read_header
from tofmix.io.schema import LAYERS, LAYERS_FIELDS, RECORDING, SURFACES
from tofmix.io.surfaces.surfaces_file import SurfacesFile
from tofmix.io.verify.findings import Findings, blocks, check_fields
from tofmix.io.verify.recording import verify_recording
from tofmix.io.verify.surfaces import verify_surfaces
from tofmix.suspicion.rules import suspect_rules
from tofmix.wording import counted


def verify(path: Path) -> Findings:
    """Check a file, or a folder that `reconcile` wrote; a missing or unreadable one has faults too."""
    findings = Findings("unknown")
    with findings.errors(path):
        if path.is_dir():
            _verify_folder(path, findings)
        elif path.suffix == ".toml":
            findings.kind = "model"
            load_model(str(path))
        else:
            with guard.open_for_reading(path) as root:
                _verify_hdf5(root, path, findings)
    return findings


def _verify_hdf5(root: h5py.File, path: Path, findings: Findings) -> None:
    with guard.reading(path, "format"):
        kind = hdf5.text_attribute(root, "format")
    if kind == LAYERS:
        findings.kind = "layers"
        _verify_layers(root, read_header(root, path, kind=kind, make=LayersFile), findings)
    elif kind == SURFACES:
        findings.kind = "surfaces"
        verify_surfaces(root, read_header(root, path, kind=kind, make=SurfacesFile), findings)
    else:
        findings.kind = "recording"
        recording = read_header(root, path, kind=RECORDING, make=RecordingFile, required=False)
        verify_recording(root, recording, findings, ours=kind is not None)


def _verify_layers(root: h5py.File, layers: LayersFile, findings: Findings) -> None:
    check_fields(root, LAYERS_FIELDS, layers.path, findings)
    _check_windows(layers, findings)
    for windows, rows in blocks(layers.shape, layers.step):
        _check_block(layers, windows, rows, findings)
    findings.checked += len(layers.names) + 2  # and the windows' ends


def _check_windows(layers: LayersFile, findings: Findings) -> None:
    starts, stops = (bounds.astype(np.float64) for bounds in (layers.window_start, layers.window_stop))
    if (stops <= starts).any() or (np.diff(starts) <= 0).any() or len(np.unique(stops - starts)) > 1:
        findings.add("window_start", "windows must ascend, each of the same number of frames")
    options = layers.provenance.options
    window = options.get("window")
    if isinstance(window, int) and (stops - starts != window).any():
        findings.add("window_stop", f"windows are not of {counted(window, 'frame')}, as the options say")
    findings.check_source(layers.provenance.source_sha256, "recording that the layers")


def _check_block(layers: LayersFile, windows: slice, rows: slice, findings: Findings) -> None:
    where = f"from window {windows.start}, row {rows.start} on"
    try:
        block = layers.read_block(windows, rows)
    except BadInputError as error:
        for name in layers.names:
            with findings.errors(layers.path, first=where):
                layers.read_dataset(name, windows, rows)
        if findings.ok:
            findings.add_error(error, layers.path, first=where)
        return
    frames = layers.window_stop[windows].astype(np.int64) - layers.window_start[windows].astype(np.int64)
    offset = (windows.start, rows.start, 0)
    made = layers.provenance
    rules = layer_rules(block, frames, circle_mm=made.unambiguous_range_mm, samples_a_frame=made.samples_a_frame)
    for rule in (*rules, *suspect_rules(block)):
        findings.add_broken(rule.name, rule.text, rule.broken, ("window", "row", "col"), offset)


def _verify_folder(folder: Path, findings: Findings) -> None:
    findings.kind = "reconciliation"
    for name in (*model_names(1), *FILES):
        if not (folder / name).is_file():
            findings.add(name, "missing; the output of reconcile is incomplete")
    if not findings.ok:
        return
    load_model(str(folder / "model.toml"))
    for text in gap_faults(parse_gap(folder / GAP)):
        findings.add(GAP, text)
