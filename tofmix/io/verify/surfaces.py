"""Whether a surfaces file is whole and keeps its contract; part of `tofmix.io.verify.verify`."""

from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray
from tofmix.io.schema import IMAGE_FIELDS, LIST_FIELDS, OF_WINDOWS, SURFACES_FIELDS
from tofmix.io.surfaces.surfaces_file import SurfacesFile
from tofmix.io.verify.findings import Findings, check_fields
from tofmix.surfaces.found import NO_SURFACE

_UNIT_TOLERANCE = 1e-5
"""Of a normal's length: some hundred times the rounding of float32."""

_MARGIN = 1.0
"""Pixels by which a point of an edge may lie outside the centres of the image's pixels: half of one, and rounding."""


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
        broken = ~(np.abs(length - 1) <= _UNIT_TOLERANCE) & ~(no_normal & no_offset)
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
    for name, pixels in zip(("edge_row", "edge_col"), file.shape[1:], strict=True):
        if (place := small.get(name)) is not None:
            inside = (place >= -_MARGIN) & (place <= pixels - 1 + _MARGIN)
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
