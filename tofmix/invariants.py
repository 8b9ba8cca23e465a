"""Rules of every result, for any data; `tofmix verify` and the property tests apply them.

Numbers alone; files are read in `tofmix.io.verify`.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray
from tofmix.flags import MOST_UNDECIDED, Mixing, Status
from tofmix.layers import Layers

SUM_TOLERANCE = 1e-4
"""Of shares in float32: by this they may miss 1."""


class Rule(NamedTuple):
    """One rule on one dataset: its text, and the places that break it, of the pixels' leading shape."""

    name: str
    text: str
    broken: BoolArray


def in_any_layer(broken: BoolArray) -> BoolArray:
    """Pixels that break a rule in any layer."""
    return np.asarray(broken.any(-1))


def layer_rules(
    layers: Layers,
    window_frames: NDArray[np.integer],
    *,
    circle_mm: float | None = None,
    samples_a_frame: int = 1,
    is_filtered: bool = False,
) -> Iterator[Rule]:
    """Apply every rule to layers.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (window, row, col).
    window_frames : (window,) array of int
        Frames of each window.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.
    samples_a_frame : int
        Samples that a frame has of each pixel, at most.
    is_filtered : bool
        Whether the camera filters its ranges over time: then not each frame has an independent sample.

    Yields
    ------
    Rule
        With `broken` (window, row, col); all false where it holds.
    """
    n = layers.n_modes
    present = np.arange(layers.max_layers) < n[..., None]
    fitted = layers.status != int(Status.TOO_FEW_SAMPLES)
    yield Rule("n_modes", f"at most {layers.max_layers}, the layers that there is room for", n > layers.max_layers)
    yield from _patterns(layers, present)
    yield from _bounds(layers, present)
    ranges = layers.range
    with np.errstate(invalid="ignore"):
        falls = in_any_layer(np.diff(ranges, axis=-1) < 0)
        yield Rule("range", "near to far", falls)
        if circle_mm is not None:
            outside = ((ranges < 0) | (ranges >= circle_mm)) & present
            yield Rule("range", f"within [0, {circle_mm:g}) mm, the circle", in_any_layer(outside))
    yield from _shares(layers, present, fitted)
    yield from _statuses(layers, present, fitted)
    if layers.mixing is not None:
        yield from _mixing(layers, layers.mixing)
    frames = np.asarray(window_frames).reshape(-1, 1, 1)
    yield Rule("n_samples", "at most the frames of the window", layers.n_samples > frames * samples_a_frame)
    if layers.invalid_share is not None:
        yield from _lost(layers, layers.invalid_share, frames, samples_a_frame, is_filtered=is_filtered)
    yield Rule(
        "log_likelihood", "finite where a pixel was fitted, else NaN", np.isfinite(layers.log_likelihood) != fitted
    )


def _patterns(layers: Layers, present: BoolArray) -> Iterator[Rule]:
    """Where there are numbers: before `n_modes`, and NaN exactly past it."""
    for name in ("range", "sigma", "weight"):
        values = getattr(layers, name)
        wrong = np.where(present, ~np.isfinite(values), ~np.isnan(values))
        yield Rule(name, "finite for the first n_modes layers, NaN past them", in_any_layer(wrong))
    light = () if layers.amplitude is None else ("amplitude",)
    for name in ("range_stderr", "weight_stderr", "probability", *light):
        values = getattr(layers, name)
        wrong = np.where(present, np.isinf(values), ~np.isnan(values))
        yield Rule(name, "never infinite, NaN past n_modes", in_any_layer(wrong))


def _bounds(layers: Layers, present: BoolArray) -> Iterator[Rule]:
    """Bounds of numbers that are there."""
    with np.errstate(invalid="ignore"):
        for name, text, wrong in (
            ("sigma", "above 0", layers.sigma <= 0),
            ("weight", "between 0 and 1", _no_share(layers.weight)),
            ("range_stderr", "above 0", layers.range_stderr <= 0),
            ("weight_stderr", "not below 0", layers.weight_stderr < 0),
            ("probability", "between 0 and 1", (layers.probability < 0) | (layers.probability > 1)),
        ):
            yield Rule(name, text, in_any_layer(wrong & present))


def _no_share(values: NDArray[np.floating]) -> BoolArray:
    return np.asarray((values < -SUM_TOLERANCE) | (values > 1 + SUM_TOLERANCE))


def _shares(layers: Layers, present: BoolArray, fitted: BoolArray) -> Iterator[Rule]:
    others = layers.weight_no_return, layers.weight_outlier
    for name, values in zip(("weight_no_return", "weight_outlier"), others, strict=True):
        with np.errstate(invalid="ignore"):
            wrong = np.where(fitted, ~np.isfinite(values) | _no_share(values), ~np.isnan(values))
        yield Rule(name, "between 0 and 1 where a pixel was fitted, else NaN", wrong)
    total = np.where(present, layers.weight, 0).sum(-1, dtype=np.float64) + others[0] + others[1]
    with np.errstate(invalid="ignore"):
        wrong = fitted & ~(np.abs(total - 1) <= SUM_TOLERANCE)
    yield Rule("weight", "sums to 1 with weight_no_return and weight_outlier", wrong)


def _statuses(layers: Layers, present: BoolArray, fitted: BoolArray) -> Iterator[Rule]:
    status, n = layers.status, layers.n_modes
    yield Rule("status", f"one of {', '.join(str(int(s)) for s in Status)}", ~np.isin(status, [int(s) for s in Status]))
    yield Rule("status", "too_few_samples and no_surface have no layer", (n > 0) & np.isin(status, _EMPTY))
    yield Rule("status", "ok, not_converged and degenerate have a layer", (n == 0) & np.isin(status, _FILLED))
    unknown = in_any_layer(np.isnan(layers.range_stderr) & present)
    yield Rule("status", "ok has a standard error for each range", unknown & (status == int(Status.OK)))
    yield Rule("n_peaks", "0 where nothing was fitted", ~fitted & (layers.n_peaks > 0))


def _lost(
    layers: Layers, lost: NDArray[np.float32], frames: NDArray[np.integer], each: int, *, is_filtered: bool
) -> Iterator[Rule]:
    """The share of lost samples agrees with the number of valid ones."""
    yield Rule("invalid_share", "between 0 and 1 in every pixel", ~((lost >= 0) & (lost <= 1)))
    seen = np.rint((1.0 - lost.astype(np.float64)) * frames)  # frames with a valid sample
    wrong = layers.n_samples > seen * each
    if not is_filtered:
        wrong |= layers.n_samples < seen
    yield Rule("invalid_share", "the share of the frames without one of the n_samples", wrong)


def _mixing(layers: Layers, mixing: NDArray[np.uint8]) -> Iterator[Rule]:
    """The kind of mixing of a pixel agrees with its layers."""
    kinds = [int(kind) for kind in Mixing]
    yield Rule("mixing", f"one of {', '.join(map(str, kinds))}", ~np.isin(mixing, kinds))
    yield Rule("mixing", "phasor has a layer", (mixing == int(Mixing.PHASOR)) & (layers.n_modes == 0))
    with np.errstate(invalid="ignore"):
        sure = in_any_layer(layers.probability > MOST_UNDECIDED)
    text = f"at most {MOST_UNDECIDED:g} where mixing is undecided"
    yield Rule("probability", text, sure & (mixing == int(Mixing.UNDECIDED)))


_EMPTY = [int(Status.TOO_FEW_SAMPLES), int(Status.NO_SURFACE)]
_FILLED = [int(Status.OK), int(Status.NOT_CONVERGED), int(Status.DEGENERATE)]
