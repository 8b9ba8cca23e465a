"""Whether files are whole and keep their contract: every chunk read, every rule applied, block by block.

`verify` takes a recording, a layers file, a surfaces file, a model, a sensor file or a reconciliation's folder. It
reports faults and never raises for them.

Faults are gathered over the blocks of a file: one line for each fault. `check_fields` holds the datasets of any file
against their declarations: units, checksums, missing chunks.
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
from numpy.typing import NDArray

from tofmix.arrays import BoolArray
from tofmix.errors import BadInputError
from tofmix.invariants import SUM_TOLERANCE, layer_rules
from tofmix.io import hdf5
from tofmix.io.guard import guard
from tofmix.io.guard.structure_rules import FLETCHER32, filters_of
from tofmix.io.hdf5 import read_header
from tofmix.io.layers.layers_file import LayersFile
from tofmix.io.model_file import load_model
from tofmix.io.reconciliation import FILES, GAP, gap_faults, model_names, parse_gap
from tofmix.io.recording.recording_file import RecordingFile
from tofmix.io.schema import (
    IMAGE_FIELDS,
    LAYERS,
    LAYERS_FIELDS,
    LIST_FIELDS,
    OF_WINDOWS,
    RANGE,
    RECORDING,
    RECORDING_FIELDS,
    SURFACES,
    SURFACES_FIELDS,
    TRUTH_FIELDS,
    Field,
)
from tofmix.io.surfaces_file import SurfacesFile
from tofmix.surfaces.found import NO_SURFACE
from tofmix.suspicion import suspect_rules
from tofmix.wording import counted


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


_BLOCK_SAMPLES = 1 << 22  # samples that are checked at once


def verify_recording(root: h5py.File, recording: RecordingFile, findings: Findings, *, ours: bool) -> None:
    """Check an open recording, whose header has passed already; `ours`: it is marked as of the tofmix format."""
    with guard.reading(recording.path, RANGE.name):  # the units of the ranges are of the header
        check_storage(root[RANGE.name], RANGE.name, findings, ours=ours)
    check_fields(root, RECORDING_FIELDS[1:], recording.path, findings, ours=ours)
    valid = _check_samples(recording, findings)
    if not valid and findings.ok:
        findings.notes.append("range: no valid sample")
    with findings.errors(recording.path):
        _check_per_frame(recording, findings)
    if recording.has_truth:
        with findings.errors(recording.path):
            _check_truth(root, recording, findings)
    if recording.sensor.noise is None:
        findings.notes.append("sensor: no noise curve; estimate measures one, or takes --noise PROFILE")


def _check_samples(recording: RecordingFile, findings: Findings) -> int:
    """Read every sample, for its checksum; return how many are valid."""
    valid = 0
    readers = {"range": recording.read_range}
    if recording.has_amplitude:
        readers["amplitude"] = recording.read_amplitude
    high, deep = recording.row_step, recording.frame_step
    deep *= max(1, _BLOCK_SAMPLES // (recording.shape[2] * high * deep))
    for name, read in readers.items():
        for frames, rows in blocks(recording.shape, (deep, high)):
            with findings.errors(recording.path, first=f"from frame {frames.start}, row {rows.start} on"):
                block = read(frames, rows)
                if name == "range":
                    valid += int(np.isfinite(block).sum())
                    with np.errstate(invalid="ignore"):
                        negative = block < 0
                    place = ("sample" if recording.targets else "frame", "row", "col")
                    findings.add_broken(name, "not below 0 mm", negative, place, (frames.start, rows.start, 0))
        findings.checked += 1
    return valid


def _check_per_frame(recording: RecordingFile, findings: Findings) -> None:
    time_s = recording.read_time()
    if time_s is not None:
        findings.checked += 1
        if not np.isfinite(time_s).all():
            findings.add("time", f"no time of {counted(int((~np.isfinite(time_s)).sum()), 'frame')}")
        else:
            findings.add_broken("time", "ascending", np.diff(time_s, prepend=-np.inf) <= 0, ("frame",), (0,))
    findings.checked += recording.read_temperature() is not None


def _check_truth(root: h5py.File, recording: RecordingFile, findings: Findings) -> None:
    """Check the truth of a synthetic recording: patterns of NaN, order, shares."""
    path, image = recording.path, recording.shape[1:]
    arrays = {}
    for spec in TRUTH_FIELDS:
        what = f"truth/{spec.name}"
        dataset = guard.checked_dataset(root, what, path)
        if dataset.shape[:2] != image or dataset.ndim != len(spec.dims):
            raise BadInputError(f"{path}: {what}: shape {dataset.shape} does not match range {recording.shape}")
        with guard.reading(path, what):
            check_storage(dataset, what, findings, ours=True)
            arrays[spec.name] = np.asarray(dataset[...])
        findings.checked += 1
    n, ranges, weights, no_return = arrays.values()
    if ranges.shape != weights.shape:
        raise BadInputError(f"{path}: truth/weight_true: shape {weights.shape} differs from range_true {ranges.shape}")
    present = np.arange(ranges.shape[2]) < n[..., None]
    shares = np.where(present, weights, 0).sum(-1, dtype=np.float64) + no_return
    pattern = "finite for the first n_modes layers, NaN past them"
    with np.errstate(invalid="ignore"):
        shared = ((weights < 0) & present).any(-1) | ~(shares <= 1 + SUM_TOLERANCE) | ~(no_return >= 0)
        rules = (
            ("range_true", pattern, (np.isfinite(ranges) != present).any(-1)),
            ("weight_true", pattern, (np.isfinite(weights) != present).any(-1)),
            ("range_true", "near to far", (np.diff(ranges, axis=-1) < 0).any(-1)),
            ("weight_true", "between 0 and 1, and so its sum with weight_no_return", shared),
        )
    for name, text, broken in rules:
        findings.add_broken(f"truth/{name}", text, np.asarray(broken), ("row", "col"), (0, 0))


def verify_surfaces(root: h5py.File, file: SurfacesFile, findings: Findings) -> None:
    """Check an open surfaces file, whose header has passed already."""
    check_fields(root, SURFACES_FIELDS, file.path, findings)
    small: dict[str, NDArray[Any]] = {}
    for name in (spec.name for spec in LIST_FIELDS if spec.name in file.names):
        with findings.errors(file.path):
            small[name] = file.read_dataset(name)
    _check_planes(small, findings)
    _check_edges(file, small, findings)
    for name in reversed(OF_WINDOWS):
        with findings.errors(file.path):
            file.read_windows(name)
    _check_images(file, small, findings)
    findings.checked += len(file.names)
    findings.check_source(file.provenance.source_sha256, "layers file that the surfaces")


def _check_planes(small: dict[str, NDArray[Any]], findings: Findings) -> None:
    """Check planes; a smooth surface has neither normal nor offset."""
    normal, offset = small.get("plane_normal"), small.get("plane_offset_mm")
    no_normal = np.False_ if normal is None else np.isnan(normal).all(axis=-1)
    no_offset = np.False_ if offset is None else np.isnan(offset)
    if normal is not None:
        length = np.linalg.norm(normal.astype(np.float64), axis=-1)
        unit_tolerance = 1e-5  # of a normal's length: some hundred times the rounding of float32
        broken = ~(np.abs(length - 1) <= unit_tolerance) & ~(no_normal & no_offset)
        findings.add_broken("plane_normal", "of unit length, or NaN with its offset", broken, ("surface_index",), (0,))
    for name, values, text, unknown in (
        ("plane_offset_mm", offset, "0 mm or more, or NaN with its normal", no_normal & no_offset),
        ("rms_mm", small.get("rms_mm"), "0 mm or more", np.False_),
    ):
        if values is not None:
            broken = ~(np.isfinite(values) & (values >= 0)) & ~unknown
            findings.add_broken(name, text, broken, ("surface_index",), (0,))


def _check_edges(file: SurfacesFile, small: dict[str, NDArray[Any]], findings: Findings) -> None:
    rules: list[tuple[str, str, BoolArray]] = []
    # Pixels by which a point of an edge may lie outside the centres of the image's pixels: half of one, and rounding.
    margin = 1.0
    for name, pixels in zip(("edge_row", "edge_col"), file.shape[1:], strict=True):
        if (place := small.get(name)) is not None:
            inside = (place >= -margin) & (place <= pixels - 1 + margin)
            rules.append((name, "in the image", ~inside))
    if (stderr := small.get("edge_stderr")) is not None:
        rules.append(("edge_stderr", "not below 0", (stderr < 0) | np.isinf(stderr)))
    sides = [name for name in ("edge_near", "edge_far") if name in small]
    rules += [(name, _numbers_text(file), ~_is_known(small[name], file)) for name in sides]
    if (line := small.get("edge_line")) is not None:
        step = np.diff(line.astype(np.int64), prepend=-1)
        first = np.arange(len(line)) == 0
        rules.append(("edge_line", "ascending from 0 by 1", np.where(first, step != 1, (step != 0) & (step != 1))))
        if (window := small.get("edge_window")) is not None:
            other = np.diff(window.astype(np.int64), prepend=0) != 0
            rules.append(("edge_line", "of one window", other & (step == 0) & ~first))
    for name, text, broken in rules:
        findings.add_broken(name, text, broken, ("edge_point",), (0,))


def _numbers_text(file: SurfacesFile) -> str:
    return f"surfaces {NO_SURFACE} to {file.surfaces - 1}"


def _is_known(numbers: NDArray[Any], file: SurfacesFile) -> BoolArray:
    return np.asarray((numbers >= NO_SURFACE) & (numbers < file.surfaces))


def _check_images(file: SurfacesFile, small: dict[str, NDArray[Any]], findings: Findings) -> None:
    """Check the images of each window, then the number of layers of each surface."""
    counts = np.zeros(file.surfaces, dtype=np.int64)
    for window in range(file.shape[0]):
        for spec in IMAGE_FIELDS:
            with findings.errors(file.path, first=f"from window {window} on"):
                values, place = file.read_dataset(spec.name, slice(window, window + 1)), (window, 0, 0, 0)
                at = spec.dims, place[: len(spec.dims)]
                if spec.name == "range_fine":
                    broken = ~(np.isnan(values) | ((values > 0) & np.isfinite(values)))
                    findings.add_broken(spec.name, "above 0 mm or NaN", broken, *at)
                    continue
                _check_numbers(file, spec.name, values, small.get("surface_window"), at, findings)
                if spec.name == "surface":
                    known = values[(values >= 0) & (values < file.surfaces)]
                    counts += np.bincount(known, minlength=file.surfaces)
    n_pixels = small.get("n_pixels")
    is_counted = all(name != "surface" for name, _ in findings.faults)  # the count of a damaged image says nothing
    if n_pixels is not None and is_counted:
        broken = n_pixels != counts
        findings.add_broken("n_pixels", "the layers that are of the surface", broken, ("surface_index",), (0,))


def _check_numbers(
    file: SurfacesFile,
    name: str,
    numbers: NDArray[Any],
    surface_window: NDArray[Any] | None,
    place: tuple[tuple[str, ...], tuple[int, ...]],
    findings: Findings,
) -> None:
    """Check that an image (1, ...) of a window names surfaces that are in the file, and of this window."""
    known = _is_known(numbers, file)
    findings.add_broken(name, _numbers_text(file), ~known, *place)
    if surface_window is not None and len(surface_window):
        window = surface_window[np.where(known & (numbers >= 0), numbers, 0)]
        other = known & (numbers >= 0) & (window != place[1][0])
        findings.add_broken(name, "of the surfaces of its window", other, *place)


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
    rules = layer_rules(
        block,
        frames,
        circle_mm=made.unambiguous_range_mm,
        samples_a_frame=made.samples_a_frame,
        is_filtered=made.sensor.temporal_filter is not None,
    )
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
