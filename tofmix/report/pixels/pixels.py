"""One pixel and its neighbours: their layers, their samples, and the density over the number of samples.

Use `view_pixels` for neighbouring pixels as in the paper's Fig. 8, and `grow_density` for its Fig. 7. Drawing is left
to `tofmix.report.pixels.pixel_figures`; `pixel_figure` gives a figure as a file, and needs the extra ``report`` only
when it is called.

Pixels as short plain text tables for the terminal; for scripts use `PixelView.as_dict`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.circle import cut_between, fold, open_at
from tofmix.errors import UsageError
from tofmix.estimation.learnt.pixel_mixture import PixelMixture, pixel_mixture
from tofmix.estimation.peaks.incremental import IncrementalDensity
from tofmix.estimation.peaks.modes import find_modes
from tofmix.estimation.settings import Refine, SigmaMode
from tofmix.flags import Mixing, mixing_name, status_name
from tofmix.layers import Layers, Provenance
from tofmix.recording import SampleSource, samples_a_frame
from tofmix.report.pixels.phasor_plane import PhasorPlane
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.wording import counted, finite_or_none

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tofmix.report.theme import Format, Theme


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelView:
    """A pixel in one window."""

    # The pixel.
    row: int
    col: int
    # (layer,) float64: its layers, near to far; NaN where not known.
    range_mm: FloatArray
    range_stderr_mm: FloatArray
    weight: FloatArray
    weight_stderr: FloatArray
    sigma_mm: FloatArray
    probability: FloatArray
    # p(c_0) and p(c_r).
    weight_no_return: float
    weight_outlier: float
    status: str  # name of the estimator's outcome
    # Valid samples used; peaks of the density in step 1.
    n_samples: int
    n_peaks: int
    # (sample,) float64 or None: valid samples in the order of their frames; None without a recording.
    samples_mm: FloatArray | None = None
    # (mode,) float64 or None: peaks of the density of these samples; None without samples or without a noise curve.
    modes_mm: FloatArray | None = None
    # The fitted mixture under learnt noise; None if the pixel was fitted with Gaussians of the curve.
    mixture: PixelMixture | None = None
    mixing: str | None = None  # name of its kind of mixing (`tofmix.flags.Mixing`); None in files without it

    @property
    def name(self) -> str:
        """``row 72, column 92``."""
        return f"row {self.row}, column {self.col}"

    def opened(self, cut_mm: float, unambiguous_range_mm: float) -> "PixelView":
        """Ranges on a line that begins at a cut of the circle, to be drawn; see `tofmix.circle.open_at`."""

        def opened(values: FloatArray | None) -> FloatArray | None:
            return None if values is None else open_at(values, cut_mm, unambiguous_range_mm)

        return replace(
            self,
            range_mm=open_at(self.range_mm, cut_mm, unambiguous_range_mm),
            samples_mm=opened(self.samples_mm),
            modes_mm=opened(self.modes_mm),
            mixture=None if self.mixture is None else self.mixture.opened(cut_mm, unambiguous_range_mm),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the same as dicts and lists, for JSON; None for unknown values.

        ``learnt_noise`` is there with learnt noise alone: the pixel's own width, its background, and how far each of
        its layers drifts within the window. ``mixing`` is there where the file has it.
        """
        layers = [
            {name: finite_or_none(float(getattr(self, name)[k])) for name in _PER_LAYER}
            for k in range(len(self.range_mm))
        ]
        return {
            "row": self.row,
            "col": self.col,
            "status": self.status,
            "n_samples": self.n_samples,
            "n_peaks": self.n_peaks,
            **({} if self.mixing is None else {"mixing": self.mixing}),
            "layers": layers,
            "weight_no_return": finite_or_none(self.weight_no_return),
            "weight_outlier": finite_or_none(self.weight_outlier),
            "samples_mm": None if self.samples_mm is None else self.samples_mm.tolist(),
            "modes_mm": None if self.modes_mm is None else self.modes_mm.tolist(),
            **({} if self.mixture is None else {"learnt_noise": _own_noise(self)}),
        }


_PER_LAYER = ("range_mm", "range_stderr_mm", "weight", "weight_stderr", "sigma_mm", "probability")
_FIELDS = {"range_mm": "range", "range_stderr_mm": "range_stderr", "sigma_mm": "sigma"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GrowingDensity:
    """The density of one pixel over its number of samples."""

    n_samples: tuple[int, ...]  # (step,) int64: valid samples after each frame that has one
    modes_mm: tuple[FloatArray, ...]  # peaks of the density after each of them
    range_mm: FloatArray  # (place,) float64: where the density is taken
    snapshots: tuple[tuple[int, FloatArray], ...]  # number of samples and density, 1/mm, at a few of them

    def opened(self, cut_mm: float, unambiguous_range_mm: float) -> "GrowingDensity":
        """Ranges on a line that begins at a cut of the circle, to be drawn; see `tofmix.circle.open_at`."""
        range_mm = open_at(self.range_mm, cut_mm, unambiguous_range_mm)
        order = np.argsort(range_mm)
        return replace(
            self,
            modes_mm=tuple(open_at(modes, cut_mm, unambiguous_range_mm) for modes in self.modes_mm),
            range_mm=range_mm[order],
            snapshots=tuple((number, p[order]) for number, p in self.snapshots),
        )

    def changes(self) -> list[int]:
        """Steps at which the number of modes is another than before, the first and the last one included."""
        counts = [len(modes) for modes in self.modes_mm]
        last = len(counts) - 1
        return [k for k in range(len(counts)) if k in (0, last) or counts[k] != counts[k - 1]]

    def as_dict(self) -> dict[str, Any]:
        """Return samples and modes for JSON."""
        return {"n_samples": list(self.n_samples), "modes_mm": [modes.tolist() for modes in self.modes_mm]}


def neighbour_columns(col: int, *, cols: int, neighbours: int) -> list[int]:
    """Columns of a pixel and of its nearest `neighbours`, ascending.

    Nearest first, the right side before the left; at the edge of the image all from the other side.
    """
    count = min(neighbours, cols - 1) + 1
    first = min(max(0, col - (count - 1) // 2), cols - count)
    return list(range(first, first + count))


def view_pixels(
    layers: Layers,
    *,
    row: int,
    cols: list[int],
    samples: FloatArray | None,
    noise: NoiseCurve | None,
    unambiguous_range_mm: float | None = None,
    learnt: Sensor | None = None,
) -> list[PixelView]:
    """View pixels of one row.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    row : int
        The row.
    cols : list of int
        The columns.
    samples : (frame, col) float, optional
        Samples of the whole row, mm, NaN where invalid.
    noise : NoiseCurve, optional
        sigma(r), for the modes.
    unambiguous_range_mm : float, optional
        Where the ranges are on a circle: its length, mm. Samples are folded, and modes looked for across the fold.
    learnt : Sensor, optional
        The sensor, where the layers were counted under its learnt noise; see `learnt_sensor`.
    """
    views = []
    for col in cols:
        n_modes = int(layers.n_modes[row, col])
        of_layers = {
            name: getattr(layers, _FIELDS.get(name, name))[row, col, :n_modes].astype(np.float64) for name in _PER_LAYER
        }
        valid = modes = None
        if samples is not None:
            valid = samples[np.isfinite(samples[:, col]), col].astype(np.float64)
            if unambiguous_range_mm is not None:
                valid = fold(valid, unambiguous_range_mm)
            modes = None if noise is None or valid.size == 0 else _modes(valid, noise, of_layers, unambiguous_range_mm)
        mixture = None
        if learnt is not None:
            of_frames = None if samples is None else samples[:, col].astype(np.float64)
            mixture = _mixture(layers, (row, col), of_layers, of_frames, learnt, unambiguous_range_mm)
        views.append(
            PixelView(
                row=row,
                col=col,
                **of_layers,
                weight_no_return=float(layers.weight_no_return[row, col]),
                weight_outlier=float(layers.weight_outlier[row, col]),
                status=status_name(int(layers.status[row, col])),
                n_samples=int(layers.n_samples[row, col]),
                n_peaks=int(layers.n_peaks[row, col]),
                samples_mm=valid,
                modes_mm=modes,
                mixture=mixture,
                mixing=None if layers.mixing is None else mixing_name(int(layers.mixing[row, col])),
            )
        )
    return views


def learnt_sensor(provenance: Provenance) -> Sensor | None:
    """The sensor of a layers file whose surfaces were counted under learnt noise; None for any other file.

    Free sigmas, and peaks taken as surfaces, use a Gaussian alone.
    """
    sensor, options = provenance.sensor, provenance.options
    of_peaks = bool(options.get("paper")) or options.get("refine") == Refine.NONE
    gaussian = of_peaks or options.get("sigma") == SigmaMode.FREE
    return None if sensor.noise is None or sensor.learnt is None or gaussian else sensor


def drifts(provenance: Provenance) -> bool:
    """Whether the ranges of a pixel could drift within a window when its layers were fitted; on a circle none could."""
    sensor = learnt_sensor(provenance)
    on_line = provenance.unambiguous_range_mm is None
    return on_line and sensor is not None and sensor.learnt is not None and bool(sensor.learnt.drift_mm.any())


def _mixture(
    layers: Layers,
    pixel: tuple[int, int],
    of_layers: dict[str, FloatArray],
    samples: FloatArray | None,
    sensor: Sensor,
    length_mm: float | None,
) -> PixelMixture:
    return pixel_mixture(
        sensor,
        **{name: of_layers[name] for name in ("range_mm", "sigma_mm", "weight")},
        width=1.0 if layers.noise_width is None else float(layers.noise_width[pixel]),
        background=float(layers.weight_outlier[pixel]),
        no_return=float(layers.weight_no_return[pixel]),
        samples_mm=samples,
        unambiguous_range_mm=length_mm,
    )


def _own_noise(view: PixelView) -> dict[str, Any]:
    mixture = view.mixture
    assert mixture is not None  # noqa: S101  called for learnt noise alone
    drift = mixture.drift_extent_mm().tolist()
    known = view.samples_mm is not None
    return {"width": mixture.width, "background": mixture.background, "drift_mm": drift if known else None}


def _modes(
    samples_mm: FloatArray, noise: NoiseCurve, of_layers: dict[str, FloatArray], length_mm: float | None
) -> FloatArray:
    """Peaks of the density; on a circle those of the line that begins between the layers."""
    if length_mm is None:
        return np.asarray(find_modes(samples_mm, noise))
    cut = cut_between(of_layers["range_mm"], of_layers["sigma_mm"], length_mm)
    return np.sort(fold(find_modes(open_at(samples_mm, cut, length_mm), noise), length_mm))


def row_samples(recording: SampleSource, *, row: int, start: int, stop: int) -> FloatArray:
    """Samples (sample, col) of one row over frames [start, stop), with all their targets, mm, NaN where invalid."""
    each = samples_a_frame(recording)
    block = recording.read_range(slice(start * each, stop * each), slice(row, row + 1))
    return np.asarray(block[:, 0, :], dtype=np.float64)


def grow_density(
    samples_mm: FloatArray,
    sensor: Sensor,
    *,
    unambiguous_range_mm: float | None = None,
    shares: tuple[float, ...] = (0.05, 0.15, 0.3, 0.6, 1.0),
) -> GrowingDensity:
    """Add a pixel's samples one by one and look for modes after each.

    Parameters
    ----------
    samples_mm : (sample,) float64
        Valid samples in the order of their frames, at least one.
    sensor : Sensor
        Noise curve and working range.
    unambiguous_range_mm : float, optional
        Length of the circle that ranges are on, mm.
    shares : tuple of float
        Shares of the samples at which the density is kept, 0 to 1, as in docs/results/paper.md.

    Raises
    ------
    ValueError
        If a noise curve, a working range or a sample is missing, or the circle is too short.
    """
    if samples_mm.size == 0:
        raise ValueError("the pixel has no valid sample")
    live = IncrementalDensity(sensor, 1, unambiguous_range_mm=unambiguous_range_mm)
    shown = {max(1, round(share * samples_mm.size)) for share in shares}
    modes, snapshots = [], []
    for number, sample in enumerate(samples_mm, 1):
        live.add(np.array([[sample]]))
        peaks = live.modes()
        modes.append(peaks.place[0, : int(peaks.found[0])].copy())
        if number in shown:
            snapshots.append((number, live.density()[0]))
    return GrowingDensity(
        n_samples=tuple(range(1, samples_mm.size + 1)),
        modes_mm=tuple(modes),
        range_mm=live.range_mm,
        snapshots=tuple(snapshots),
    )


_COUNTED_ALONE = (None, *(mixing_name(kind) for kind in (Mixing.ONE_SURFACE, Mixing.EVENTS)))
"""Kinds of mixing in which the samples of the pixel alone gave its surfaces."""


def format_pixels(views: list[PixelView], chosen: int) -> str:
    """Format pixels for the terminal, the one of column `chosen` first; no newline at the end."""
    ordered = sorted(views, key=lambda view: (view.col != chosen, view.col))
    return "\n\n".join("\n".join(_pixel_lines(view)) for view in ordered)


def why_layers_stand(views: list[PixelView], options: Mapping[str, str | float]) -> str | None:
    """Text on the probability of kept layers; None if surfaces were not counted by likelihood, with these options.

    Layers of phasor sums, and undecided ones, are kept by other rules.
    """
    if options.get("refine") != "likelihood" or options.get("paper"):
        return None
    if not any(len(view.range_mm) and view.mixing in _COUNTED_ALONE for view in views):
        return None
    limit = float(options.get("false_alarm", 0.0))
    return (
        f"probability: 1 minus the probability that noise alone gains as much likelihood as the layer;"
        f"\nfor a layer far from all others it is not computed, and is 1;"
        f"\nestimate kept layers of {1.0 - limit:.6g} or more (--false-alarm {limit:g})"
    )


def _pixel_lines(view: PixelView) -> list[str]:
    count = len(view.range_mm)
    found = f"{counted(count, 'layer')}, {view.status}, {counted(view.n_samples, 'sample')}"
    lines = [f"{view.name}: {found}, {counted(view.n_peaks, 'peak')}"]
    if count:
        lines.append(f"{'layer':>7}{'range mm':>11}{'+-':>9}{'share':>9}{'+-':>8}{'sigma mm':>10}{'probability':>13}")
    lines += [_layer_line(view, k) for k in range(count)]
    if view.mixing is not None:
        lines.append(f"  mixing: {view.mixing.replace('_', ' ')}")
    lines.append(f"  no return {view.weight_no_return:.4f}, outliers {view.weight_outlier:.2g}")
    if not view.n_samples:
        lines.append(
            "  none of its samples is valid: too dark, saturated, out of range, or dropped when it was imported"
        )
    if view.mixture is not None and count:
        lines.append(f"  noise of the pixel: {_own_noise_words(view)}")
    if view.modes_mm is not None:
        lines.append(f"  peaks of the density (mm): {_listed(view.modes_mm)}")
    return lines


def _layer_line(view: PixelView, k: int) -> str:
    return (
        f"{k + 1:>7}{view.range_mm[k]:>11.2f}{view.range_stderr_mm[k]:>9.2f}{view.weight[k]:>9.4f}"
        f"{view.weight_stderr[k]:>8.4f}{view.sigma_mm[k]:>10.2f}{view.probability[k]:>13.6f}"
    )


def _own_noise_words(view: PixelView) -> str:
    """Width, background and drift of a pixel under learnt noise."""
    mixture = view.mixture
    assert mixture is not None  # noqa: S101  called for learnt noise alone
    said = f"width {mixture.width:.2f}, background {100 * mixture.background:.1f} %"
    if not mixture.drift_mm.any():
        return said
    return f"{said}, drift (mm): {_listed(mixture.drift_extent_mm())}"


def format_growth(growth: GrowingDensity) -> str:
    """Format where the number of peaks changes, for the terminal; no newline at the end."""
    lines = [f"{'samples':>9}{'peaks':>7}  at (mm)"]
    lines += [
        f"{growth.n_samples[k]:>9}{len(growth.modes_mm[k]):>7}  {_listed(growth.modes_mm[k])}" for k in growth.changes()
    ]
    return "\n".join(lines)


def _listed(values: FloatArray) -> str:
    return " ".join(f"{value:.1f}" for value in values) or "none"


FIGURE_SUFFIXES: dict[str, "Format"] = {".png": "png", ".svg": "svg"}

_MISSING_EXTRA = "a figure needs matplotlib: pip install 'tofmix[report]'"


def pixel_figure(
    views: list[PixelView],
    *,
    noise: NoiseCurve | None,
    growth: GrowingDensity | None,
    kind: "Format",
    unambiguous_range_mm: float | None = None,
    plane: PhasorPlane | None = None,
) -> bytes:
    """Draw neighbouring pixels, or how the density of the first one grew over its layers, as a file.

    The parameters are those of `tofmix.report.pixels.pixel_figures`; the same input gives the same bytes.
    """
    try:
        drawings = import_module("tofmix.report.pixels.pixel_figures")
        theme = import_module("tofmix.report.theme")
    except ImportError as error:
        raise UsageError(_MISSING_EXTRA) from error
    circle = {"unambiguous_range_mm": unambiguous_range_mm}

    def draw(t: "Theme") -> "Figure":
        if growth is None:
            figure: Figure = drawings.neighbours_figure(views, noise=noise, theme=t, plane=plane, **circle)
        else:
            figure = drawings.growth_figure(growth, views[0], theme=t, **circle)
        return figure

    content: bytes = theme.figure_bytes(draw, kind)
    return content
