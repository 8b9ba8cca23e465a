"""Whether a surfaces file is whole and keeps its contract; part of `tofmix.io.verify.verify`."""

from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray
from tofmix.errors import BadInputError
from tofmix.io import hdf5
from tofmix.io.guard import guard
from tofmix.io.surfaces.fields import FIELDS
from tofmix.io.surfaces.surfaces_file import SurfacesFile
from tofmix.io.verify.findings import Findings
from tofmix.io.verify.storage import check_storage
from tofmix.surfaces.found import NO_SURFACE

_UNIT_TOLERANCE = 1e-5
"""Of a normal's length: some hundred times the rounding of float32."""

_MARGIN = 1.0
"""Pixels by which a point of an edge may lie outside the centres of the image's pixels: half of one, and rounding."""

_LARGE = ("surface", "range_fine", "surface_fine")
"""Datasets that are read window by window."""


def verify_surfaces(root: h5py.File, file: SurfacesFile, findings: Findings) -> None:
    """Check an open surfaces file: its header has passed already.

    Parameters
    ----------
    root : h5py.File
        The file.
    file : SurfacesFile
        The surfaces in it.
    findings : Findings
        Receives the findings.
    """
    for spec in FIELDS:
        if spec.name in file.names:
            with guard.reading(file.path, spec.name):
                found = hdf5.text_attribute(root[spec.name], "units")
                if found != spec.units:
                    findings.add(spec.name, f"units {found!r}, expected {spec.units!r}")
                check_storage(root[spec.name], spec.name, file.path, findings, ours=True)
    small = _read_small(file, findings)
    _check_planes(small, findings)
    _check_edges(file, small, findings)
    for name in ("surface_window", "edge_window"):
        try:
            file.read_windows(name)
        except BadInputError as error:
            findings.add_error(error, file.path)
    _check_images(file, small, findings)
    findings.checked += len(file.names)
    if len(file.provenance.source_sha256) != 64:  # noqa: PLR2004  digits of SHA-256
        findings.notes.append("no checksum of the layers file that the surfaces were made from")


def _read_small(file: SurfacesFile, findings: Findings) -> dict[str, NDArray[Any]]:
    """Read every dataset of surfaces and of points; those that can be read."""
    arrays = {}
    for name in file.names:
        if name not in _LARGE:
            try:
                arrays[name] = file.read_dataset(name)
            except BadInputError as error:
                findings.add_error(error, file.path)
    return arrays


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
    fine = ("window", "row_fine", "col_fine")
    for window in range(file.shape[0]):
        images = _read_images(file, window, findings)
        at = (window, 0, 0)
        if (range_fine := images.get("range_fine")) is not None:
            broken = ~(np.isnan(range_fine) | ((range_fine > 0) & np.isfinite(range_fine)))
            findings.add_broken("range_fine", "above 0 mm or NaN", broken[np.newaxis], fine, at)
        if (numbers := images.get("surface")) is not None:
            counts += np.bincount(numbers[(numbers >= 0) & (numbers < file.surfaces)], minlength=file.surfaces)
        for name, dims in (("surface", ("window", "row", "col", "layer")), ("surface_fine", fine)):
            if (numbers := images.get(name)) is not None:
                place = at[: len(dims)] if len(dims) == len(at) else (*at, 0)
                _check_numbers(file, name, numbers[np.newaxis], small.get("surface_window"), (dims, place), findings)
    n_pixels = small.get("n_pixels")
    is_counted = all(name != "surface" for name, _ in findings.faults)  # the count of a damaged image says nothing
    if n_pixels is not None and is_counted:
        broken = n_pixels != counts
        findings.add_broken("n_pixels", "the layers that are of the surface", broken, ("surface_index",), (0,))


def _read_images(file: SurfacesFile, window: int, findings: Findings) -> dict[str, NDArray[Any]]:
    images = {}
    for name in _LARGE:
        try:
            images[name] = file.read_dataset(name, slice(window, window + 1))[0]
        except BadInputError as error:
            findings.add_error(error, file.path, first=f"from window {window} on")
    return images


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
