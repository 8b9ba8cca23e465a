"""Differences of two layers files of one size: in the number of surfaces, or in ranges beyond their errors.

Use it for two estimates of one recording (other options, another version) or of
two recordings of one scene. Windows are read one by one. Two estimates of one
recording share its noise: there a difference of a standard error is already much.
"""

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tofmix.errors import BadInputError
from tofmix.flags import status_name
from tofmix.layers import Layers
from tofmix.report.comparison.window_difference import WindowDifference, compare_windows
from tofmix.report.sources import LayersSource
from tofmix.report.summary.quantiles import ValueCounts
from tofmix.wording import counted, finite_or_none


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelDifference:
    """One pixel that differs. Ranges are in mm; `gap_errors` is None if the numbers of surfaces differ."""

    window: int
    row: int
    col: int
    surfaces: tuple[int, int]
    status: tuple[str, str]
    range_a_mm: tuple[float | None, ...]
    range_b_mm: tuple[float | None, ...]
    gap_errors: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two layers files against each other. Pixels are counted once a window."""

    tolerance: float  # in combined standard errors
    # Sizes; pixels = windows * rows * cols.
    windows: int
    rows: int
    cols: int
    pixels: int
    # Pixels that differ: in number of surfaces, or in a range. A status alone is no difference.
    different: int
    count_differs: int
    range_differs: int
    status_differs: int  # pixels with another status
    surfaces: tuple[tuple[int, int, int], ...]  # surfaces in A, in B, pixels; those that differ, most frequent first
    # Pairs of layers in pixels with as many surfaces in both; pairs beyond the tolerance.
    layers_compared: int
    layers_differ: int
    # Size of the pairs' differences. None without a pair; the last also where an error is not known.
    gap_median_mm: float | None
    gap_largest_mm: float | None
    gap_largest_errors: float | None
    different_by_window: tuple[int, ...]  # pixels that differ in each window
    options: dict[str, tuple[Any, Any]]  # options of estimate that differ
    sources: tuple[str, str]  # the recordings
    same_recording: bool  # whether both were made from one recording, by its checksum
    pixels_shown: tuple[PixelDifference, ...]  # the most different ones

    def as_dict(self) -> dict[str, Any]:
        """Return the same as dicts and lists, for JSON."""
        return asdict(self)

    def equal(self, allow: float) -> bool:
        """Whether at most this share of the pixels differs."""
        return self.different <= allow * self.pixels


def check_comparable(a: LayersSource, b: LayersSource) -> None:
    """Refuse files of different sizes.

    Raises
    ------
    BadInputError
        If windows, rows or columns differ, or windows lie over other numbers of frames.
    """
    if a.shape != b.shape:
        sizes = " and ".join(f"{counted(w, 'window')} of {r} x {c} pixels" for w, r, c in (a.shape, b.shape))
        raise BadInputError(f"the two have different sizes, {sizes}")
    lengths = [np.unique(one.window_stop - one.window_start).tolist() for one in (a, b)]
    if lengths[0] != lengths[1]:
        raise BadInputError(f"their windows have {lengths[0]} and {lengths[1]} frames")


def common_circle(a: LayersSource, b: LayersSource) -> float | None:
    """Length of the circle that the ranges of both files are on, mm; None where they are on a line, or not on one."""
    length, other = a.provenance.unambiguous_range_mm, b.provenance.unambiguous_range_mm
    return length if length == other else None


def compare(a: LayersSource, b: LayersSource, *, tolerance: float = 3.0, shown_pixels: int = 20) -> Comparison:
    """Compare all windows of two layers files.

    Parameters
    ----------
    a, b : LayersSource
        For example open `tofmix.io.layers.layers_file.LayersFile`.
    tolerance : float
        Largest difference of equal ranges, in combined standard errors, at least 0.
    shown_pixels : int
        Pixels that are listed, the most different first.

    Raises
    ------
    BadInputError
        If they differ in size.
    """
    check_comparable(a, b)
    tally = _Tally(shown_pixels)
    windows, rows, cols = a.shape
    circle_mm = common_circle(a, b)
    for window in range(windows):
        of_a, of_b = a.read_window(window), b.read_window(window)
        found = compare_windows(of_a, of_b, tolerance=tolerance, unambiguous_range_mm=circle_mm)
        tally.add(window, of_a, of_b, found)
    made = a.provenance, b.provenance
    names = sorted({*made[0].options, *made[1].options})
    options = {
        name: (finite_or_none(made[0].options.get(name)), finite_or_none(made[1].options.get(name))) for name in names
    }
    return Comparison(
        tolerance=tolerance,
        windows=windows,
        rows=rows,
        cols=cols,
        pixels=windows * rows * cols,
        different=sum(tally.by_window),
        count_differs=tally.count,
        range_differs=tally.range,
        status_differs=tally.status,
        surfaces=tally.surfaces(),
        layers_compared=tally.gaps.count,
        layers_differ=tally.layers,
        gap_median_mm=tally.gaps.quantiles(0.5)[0],
        gap_largest_mm=tally.largest_mm if tally.gaps.count else None,
        gap_largest_errors=tally.largest_errors if tally.gaps.count and np.isfinite(tally.largest_errors) else None,
        different_by_window=tuple(tally.by_window),
        options={name: pair for name, pair in options.items() if pair[0] != pair[1]},
        sources=(made[0].source, made[1].source),
        same_recording=made[0].source_sha256 == made[1].source_sha256,
        pixels_shown=tally.shown(),
    )


class _Tally:
    """Running counts over windows."""

    def __init__(self, most_shown: int) -> None:
        self._most_shown = most_shown
        self.count = self.range = self.status = self.layers = 0
        self.by_window: list[int] = []
        self.gaps = ValueCounts()
        self.largest_mm = self.largest_errors = 0.0
        self._surfaces: Counter[tuple[int, int]] = Counter()
        self._shown: list[tuple[tuple[float, ...], PixelDifference]] = []

    def add(self, window: int, a: Layers, b: Layers, found: WindowDifference) -> None:
        self.count += int(found.count_differs.sum())
        self.range += int(found.range_differs.sum())
        self.status += int(found.status_differs.sum())
        self.layers += int(found.layer_differs.sum())
        self.by_window.append(int(found.differs.sum()))
        sizes = np.abs(found.gap_mm)
        self.gaps.add(sizes)
        self.largest_mm = max(self.largest_mm, float(np.fmax.reduce(sizes, axis=None, initial=0.0)))
        in_errors = np.abs(found.gap_errors)
        self.largest_errors = max(self.largest_errors, float(np.fmax.reduce(in_errors, axis=None, initial=0.0)))
        pairs = np.stack([a.n_modes[found.count_differs], b.n_modes[found.count_differs]], axis=-1)
        self._surfaces.update(map(tuple, pairs.tolist()))
        self._keep_most_different(window, a, b, found)

    def _keep_most_different(self, window: int, a: Layers, b: Layers, found: WindowDifference) -> None:
        row, col = np.nonzero(found.differs)
        by_count = np.abs(a.n_modes[row, col].astype(int) - b.n_modes[row, col].astype(int))
        by_range = np.fmax.reduce(np.abs(found.gap_errors[row, col]), axis=-1, initial=0.0)
        for k in np.lexsort((col, row, -by_range, -by_count))[: self._most_shown].tolist():
            place = int(row[k]), int(col[k])
            rank = (-float(by_count[k]), -float(by_range[k]), float(window), *map(float, place))
            self._shown.append((rank, _pixel(window, place, a, b, float(by_range[k]))))
        self._shown = sorted(self._shown, key=lambda item: item[0])[: self._most_shown]

    def surfaces(self) -> tuple[tuple[int, int, int], ...]:
        ordered = sorted(self._surfaces.items(), key=lambda item: (-item[1], item[0]))
        return tuple((pair[0], pair[1], count) for pair, count in ordered)

    def shown(self) -> tuple[PixelDifference, ...]:
        return tuple(pixel for _, pixel in self._shown)


def _pixel(window: int, place: tuple[int, int], a: Layers, b: Layers, gap_errors: float) -> PixelDifference:
    counts = int(a.n_modes[place]), int(b.n_modes[place])
    known = counts[0] == counts[1] and np.isfinite(gap_errors)
    return PixelDifference(
        window=window,
        row=place[0],
        col=place[1],
        surfaces=counts,
        status=(status_name(int(a.status[place])), status_name(int(b.status[place]))),
        range_a_mm=_ranges(a, place),
        range_b_mm=_ranges(b, place),
        gap_errors=gap_errors if known else None,
    )


def _ranges(layers: Layers, place: tuple[int, int]) -> tuple[float | None, ...]:
    values = layers.range[place][: int(layers.n_modes[place])].astype(np.float64).tolist()
    return tuple(round(value, 3) if np.isfinite(value) else None for value in values)
