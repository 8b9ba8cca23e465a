"""Differences of two layers files of one size: in the number of surfaces, or in ranges beyond their errors.

Use it for two estimates of one recording (other options, another version) or of
two recordings of one scene. Windows are read one by one. Two estimates of one
recording share its noise: there a difference of a standard error is already much.

`WindowDifference` has those of two windows, pixel by pixel and layer by layer; `Comparison` those of the files, as a
dictionary for scripts, a text table for the terminal (`format_comparison`) and an HTML page (`render_comparison`).
"""

from collections import Counter
from dataclasses import asdict, dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.flags import status_name
from tofmix.layers import Layers, LayersSource
from tofmix.report.summary.quantiles import ValueCounts
from tofmix.report.summary.tables import printable
from tofmix.report.templates import load_template
from tofmix.wording import counted, finite_or_none, number, percent_of

if TYPE_CHECKING:
    from tofmix.report.figures.picture import Picture


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindowDifference:
    """One window of A against one of B."""

    # (row, col) bool: another number of surfaces; another status.
    count_differs: BoolArray
    status_differs: BoolArray
    # (row, col, layer) bool: as many surfaces in both, and this one's range beyond the tolerance.
    layer_differs: BoolArray
    # (row, col, layer) float64: range of B less that of A where both have as many surfaces, mm; NaN elsewhere.
    gap_mm: FloatArray
    # (row, col, layer) float64: the same in combined standard errors; infinite where the errors are not known and the
    # ranges differ.
    gap_errors: FloatArray

    @property
    def range_differs(self) -> BoolArray:
        """Pixels with a range beyond the tolerance (row, col)."""
        return np.asarray(self.layer_differs.any(axis=-1))

    @property
    def differs(self) -> BoolArray:
        """Pixels that count as different (row, col)."""
        return self.count_differs | self.range_differs


def compare_windows(
    a: Layers, b: Layers, *, tolerance: float, unambiguous_range_mm: float | None = None
) -> WindowDifference:
    """Compare two windows of the leading shape (row, col).

    Parameters
    ----------
    a, b : Layers
        Of one leading shape; they may hold different numbers of layers.
    tolerance : float
        In combined standard errors, at least 0. Where an error is not known, ranges must be equal.
    unambiguous_range_mm : float, optional
        Where the ranges of both are on one circle: its length, mm. Differences then go the short way round, and
        layers are paired in the order round the circle in which they differ least: a surface at the fold may be
        the last layer in one and the first in the other.
    """
    shared = min(a.max_layers, b.max_layers)
    count_differs = a.n_modes != b.n_modes
    present = (np.arange(shared) < a.n_modes[..., np.newaxis]) & ~count_differs[..., np.newaxis]
    range_a, range_b = (one.range[..., :shared].astype(np.float64) for one in (a, b))
    stderr_a, stderr_b = (one.range_stderr[..., :shared].astype(np.float64) for one in (a, b))
    gap = np.where(present, range_b - range_a, np.nan)
    if unambiguous_range_mm is not None:
        pair = _pairs_on_circle(range_a, range_b, np.where(count_differs, 0, a.n_modes), unambiguous_range_mm)
        range_b, stderr_b = (np.take_along_axis(values, pair, axis=-1) for values in (range_b, stderr_b))
        gap = np.where(present, _circular_difference(range_b - range_a, unambiguous_range_mm), np.nan)
    errors = np.nan_to_num(np.hypot(stderr_a, stderr_b), nan=0.0, posinf=0.0)
    both_unknown = np.isnan(range_a) & np.isnan(range_b)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap_errors = np.where(gap == 0.0, 0.0, gap / errors)
        beyond = present & ~both_unknown & ~(np.abs(gap) <= tolerance * errors)
    return WindowDifference(
        count_differs=np.asarray(count_differs),
        status_differs=np.asarray(a.status != b.status),
        layer_differs=np.asarray(beyond),
        gap_mm=np.asarray(gap),
        gap_errors=np.asarray(gap_errors),
    )


def _circular_difference(gap_mm: FloatArray, length_mm: float) -> FloatArray:
    """Differences of two places on a circle, by the shorter way, mm."""
    return np.asarray(gap_mm - length_mm * np.round(gap_mm / length_mm))


def _pairs_on_circle(range_a: FloatArray, range_b: FloatArray, n_modes: IntArray, length_mm: float) -> IntArray:
    """For each layer of A (row, col, layer) the layer of B with which it is compared."""
    layer = np.arange(range_a.shape[-1])
    count = np.maximum(n_modes, 1).astype(np.int64)[..., np.newaxis]
    best = np.broadcast_to(layer, range_a.shape)
    least = np.full(range_a.shape[:-1], np.inf)
    for turned in range(int(count.max(initial=1))):
        # Past the pixel's layers every layer is its own pair; they are not compared.
        pair = np.where(layer < count, (layer + turned) % count, layer)
        apart = np.abs(_circular_difference(np.take_along_axis(range_b, pair, axis=-1) - range_a, length_mm))
        total = np.nansum(np.where(layer < count, apart, 0.0), axis=-1)
        better = total < least
        best, least = np.where(better[..., np.newaxis], pair, best), np.where(better, total, least)
    return np.asarray(best)


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


def format_comparison(comparison: Comparison, *, names: tuple[str, str], allow: float, shown_pairs: int = 5) -> str:
    """Format a comparison of the files `names` for the terminal, without a newline at the end.

    The `shown_pairs` most frequent pairs of numbers of surfaces are in it.
    """
    c = comparison
    image = f"{counted(c.rows, 'row')} x {counted(c.cols, 'column')}"
    lines = [
        *(f"{'AB'[k]}          {printable(names[k])}, of {printable(c.sources[k])}" for k in (0, 1)),
        f"recording  {'the same' if c.same_recording else 'not the same'}",
        f"pixels     {c.pixels} ({counted(c.windows, 'window')} of {image})",
        "",
        *(
            f"{name:<40}{count:>8}{percent_of(count, c.pixels):>9}"
            for name, count in (
                ("pixels that differ", c.different),
                ("  in the number of surfaces", c.count_differs),
                (f"  in a range, by over {c.tolerance:g} errors", c.range_differs),
                ("another status (no difference by itself)", c.status_differs),
            )
        ),
        "",
        f"layers compared   {c.layers_compared}, beyond tolerance {c.layers_differ}",
        f"range differences median {number(c.gap_median_mm, '.3g')} mm, largest {number(c.gap_largest_mm, '.3g')} mm",
        f"                  largest {number(c.gap_largest_errors, '.3g')} combined standard errors",
    ]
    lines += [f"surfaces {a} in A, {b} in B: {counted(count, 'pixel')}" for a, b, count in c.surfaces[:shown_pairs]]
    lines += [f"option {name}: {pair[0]} in A, {pair[1]} in B" for name, pair in c.options.items()]
    if c.pixels_shown:
        lines += ["", f"{'window':>6}{'row':>6}{'col':>6}{'errors':>8}  ranges in A | in B (mm)"]
        lines += [_pixel_line(pixel) for pixel in c.pixels_shown]
        if len(c.pixels_shown) < c.different:
            lines.append(f"and {c.different - len(c.pixels_shown)} more pixels")
    lines += ["", "equal" if c.equal(allow) else "different"]
    return "\n".join(lines)


def _pixel_line(pixel: PixelDifference) -> str:
    sides = (" ".join(number(mm, ".1f") for mm in side) or "none" for side in (pixel.range_a_mm, pixel.range_b_mm))
    return f"{pixel.window:>6}{pixel.row:>6}{pixel.col:>6}{number(pixel.gap_errors, '.1f'):>8}  {' | '.join(sides)}"


def render_comparison(
    a: LayersSource, b: LayersSource, *, comparison: Comparison, window: int | None, names: tuple[str, str]
) -> str:
    """Render the page of two layers files as HTML; the same input gives the same text.

    The pictures are of `window`, or of the window with most differences.
    """
    template = load_template("comparison.html")
    drawings = import_module("tofmix.report.figures.pictures")
    shown = int(np.argmax(comparison.different_by_window)) if window is None else window
    of_a, of_b = a.read_window(shown), b.read_window(shown)
    circle_mm = common_circle(a, b)
    found = compare_windows(of_a, of_b, tolerance=comparison.tolerance, unambiguous_range_mm=circle_mm)
    pictures: tuple[Picture, ...] = drawings.draw_comparison(of_a, of_b, found, tolerance=comparison.tolerance)
    return template.render(
        comparison=comparison,
        names=names,
        headline=headline(comparison),
        window=shown,
        pictures=pictures,
        made=[
            (f"{letter}: {name}", source) for letter, name, source in zip("AB", names, comparison.sources, strict=True)
        ],
        options=[(name, f"{pair[0]} in A, {pair[1]} in B") for name, pair in comparison.options.items()],
    )


def headline(comparison: Comparison) -> str:
    """Describe the differences in one sentence."""
    c = comparison
    if c.different == 0:
        return f"All {counted(c.pixels, 'pixel', ',')} agree within {c.tolerance:g} standard errors."
    return (
        f"{c.different:,} of {counted(c.pixels, 'pixel', ',')} differ: {c.count_differs:,} in the number of surfaces,"
        f" {c.range_differs:,} in a range by more than {c.tolerance:g} standard errors."
    )
