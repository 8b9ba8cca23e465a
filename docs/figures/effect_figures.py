"""Draw the signatures of the effects: the same scene with and without each one.

Run ``python docs/figures/effect_figures.py`` (some minutes), or with the names of the
effects to draw. Each picture has two panels, of bias, spread, invalid share or
memory against range, amplitude, time or place. Grey is the scene without the
effect, colour with it; lines are what the model predicts. The same versions of
tofmix and Matplotlib give the same bytes.
"""

import argparse
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from tofmix.arrays import FloatArray
from tofmix.simulation import builtin_text
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.distribution import Prediction
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.events import Truth
from tofmix.simulation.exposure import predict
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.render import render_blocks

SEED = 1
FRAMES = 100
_INK, _GREY, _BLUE, _VERMILLION = "#1f2328", "#8c959f", "#0072b2", "#d55e00"
_SETTINGS = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "text.color": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "legend.frameon": False,
}
_SIZE_INCH, _DPI = (7.6, 2.7), 100.0
_TITLE_CHARACTERS = 100  # of a line: more do not fit into the width
_BINS = 24
_FEWEST, _FEWEST_PIXELS = 40, 4  # samples, and pixels, that a point of a curve rests on
_MIDDLE_ROW, _MIXED_COL = 72, 92  # the pixel of three-boards that sees all three


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recorded:
    """A recording of a scene.

    range_mm (frame, row, col), NaN where invalid; the truth of the scene without the effect; and moved, with it.
    """

    range_mm: FloatArray
    truth: Truth
    moved: Truth
    model: Model

    @property
    def lone(self) -> FloatArray:
        """1 where a pixel sees one surface and nothing else, with and without the effect; NaN elsewhere."""
        alone = [(truth.n_modes == 1) & (truth.weight_no_return == 0) for truth in (self.truth, self.moved)]
        same = self.truth.surface[..., 0] == self.moved.surface[..., 0]
        return np.where(alone[0] & alone[1] & same, 1.0, np.nan)

    @property
    def true_mm(self) -> FloatArray:
        """True ranges (row, col) of lone pixels, mm."""
        return self.truth.range_true[..., 0].astype(np.float64) * self.lone

    @property
    def off_mm(self) -> FloatArray:
        """Recorded less true range (frame, row, col) of lone pixels, mm."""
        return self.range_mm - self.true_mm


def record(scene: str, effect: str = "", *, frames: int = FRAMES, rate_hz: float = 25.0) -> Recorded:
    """Record a built-in scene with the effect that a TOML text adds. The truth is that of the scene without it."""
    plain = parse_model(builtin_text(scene), source=scene)
    model = parse_model(builtin_text(scene) + effect, source=scene)
    model = replace(model, recording=replace(model.recording, frames=frames, frame_rate_hz=rate_hz))
    blocks = render_blocks(model, cast_scene(model), n_frames=frames, seed=SEED, threads=2)
    ranges = np.concatenate([block.range_mm for block in blocks]).astype(np.float64)
    return Recorded(
        range_mm=np.where(ranges > 0, ranges, np.nan), truth=cast_scene(plain), moved=cast_scene(model), model=model
    )


_Panel = Callable[[Axes, Recorded, Recorded], None]


def _binned(
    x: FloatArray, y: FloatArray, statistic: Callable[..., FloatArray], *, bins: int, fewest: int
) -> tuple[FloatArray, FloatArray]:
    """Mean of x and statistic of y in bins of x, where there are enough."""
    fine = np.isfinite(x) & np.isfinite(y)
    x, y = x[fine], y[fine]
    edges = np.linspace(x.min(), x.max(), bins + 1)
    which = np.clip(np.digitize(x, edges) - 1, 0, bins - 1)
    used = [k for k in range(bins) if (which == k).sum() >= fewest]
    means = np.array([x[which == k].mean() for k in used])
    return means, np.array([float(statistic(y[which == k])) for k in used])


def _curve(
    axes: Axes, x: FloatArray, y: FloatArray, color: str, statistic: Callable[..., FloatArray], bins: int
) -> None:
    axes.plot(*_binned(x, y, statistic, bins=bins, fewest=_FEWEST), "o", color=color, markersize=3.2)


def _spread(values: FloatArray, axis: int | None = None) -> FloatArray:
    """Half the interval that holds 68 %: sigma of a Gaussian, and outliers do not count."""
    low, high = np.percentile(values, [15.87, 84.13], axis=axis)
    return np.asarray((high - low) / 2, dtype=np.float64)


def _axis(axes: Axes, name: str, recorded: Recorded) -> FloatArray:
    """Values (row, col) of what a curve is drawn against."""
    if name == "range":
        axes.set_xlabel("true range (m)")
        return recorded.true_mm / 1000
    if name == "amplitude":
        axes.set_xlabel("log10 of amplitude without the effect")
        amplitude = recorded.truth.amplitude[..., 0].astype(np.float64)
        return np.log10(np.where(amplitude > 0, amplitude, np.nan)) * recorded.lone
    axes.set_xlabel("column")
    return np.broadcast_to(np.arange(recorded.range_mm.shape[2], dtype=np.float64), recorded.range_mm.shape[1:])


def _against(name: str, what: str, rows: slice = slice(None), surface: int | None = None) -> _Panel:
    """Bias, spread or invalid share in bins of range, amplitude or column, and what is predicted of lone pixels."""

    def wanted(recorded: Recorded) -> FloatArray:
        seen = recorded.truth.surface[..., 0]
        return np.where((seen == surface) | (surface is None), 1.0, np.nan)

    def panel(axes: Axes, plain: Recorded, other: Recorded) -> None:
        bins = 3 * _BINS if name == "column" else _BINS
        for recorded, color in ((plain, _GREY), (other, _BLUE)):
            x = _axis(axes, name, recorded) * wanted(recorded)
            if what == "invalid":
                lost = np.isnan(recorded.range_mm).mean(axis=0) * recorded.lone
                _curve(axes, x[rows], lost[rows], color, np.mean, _BINS)
            else:
                off = recorded.off_mm[:, rows]
                spread_x = np.broadcast_to(x[rows], off.shape)
                _curve(axes, spread_x, off, color, np.median if what == "bias" else _spread, bins)
        axes.set_ylabel({"bias": "bias (mm)", "spread": "spread (mm)", "invalid": "invalid share"}[what])
        axes.set_title(f"{what} against {name}")
        _predicted(axes, what, other, rows, _axis(axes, name, other) * wanted(other))

    return panel


def _predicted(axes: Axes, what: str, other: Recorded, rows: slice, x: FloatArray) -> None:
    """Line of the prediction at half the recording's time, of lone pixels in fine bins."""
    time_s = other.model.recording.frames / other.model.recording.frame_rate_hz / 2
    values = _statistic_of(predict(other.model, time_s=time_s, seed=SEED), what).reshape(other.true_mm.shape)
    if what == "bias":
        values = values - other.true_mm
    line = _binned(x[rows], (values * other.lone)[rows], np.median, bins=3 * _BINS, fewest=_FEWEST_PIXELS)
    axes.plot(*line, color=_INK, linewidth=0.8, zorder=1)


def _statistic_of(prediction: Prediction, what: str) -> FloatArray:
    """The prediction's own: of the weightiest component, or the invalid share."""
    if what == "invalid":
        return prediction.invalid
    best = prediction.weight.argmax(axis=0), np.arange(prediction.weight.shape[1])
    values: FloatArray = (prediction.range_mm if what == "bias" else prediction.sigma_mm)[best]
    return values


def _map(what: str) -> _Panel:
    """Image of bias, spread, ratio of spreads, or invalid share, with the effect."""

    def panel(axes: Axes, plain: Recorded, other: Recorded) -> None:
        if what == "invalid":
            image, unit = np.isnan(other.range_mm).mean(axis=0), "invalid share"
        elif what == "bias":
            image, unit = np.nanmedian(other.range_mm, axis=0) - np.nanmedian(plain.range_mm, axis=0), "mm"
        else:
            ratio = _spread(other.off_mm, axis=0) / _spread(plain.off_mm, axis=0)
            image, unit = ratio, "spread with / without"
        limit = float(np.nanpercentile(np.abs(image), 98)) or 1.0
        low, colors = (-limit, "RdBu_r") if what == "bias" else (0.0, "viridis")
        shown = axes.imshow(image, vmin=low, vmax=limit, cmap=colors, interpolation="nearest")
        axes.figure.colorbar(shown, ax=axes, shrink=0.85, label=unit)
        axes.set(xticks=[], yticks=[])
        axes.set_title({"bias": "bias by pixel", "invalid": "invalid share by pixel", "ratio": "spread by pixel"}[what])

    return panel


def _over_time(what: str, surface: int | None = None) -> _Panel:
    """Bias or spread of the whole image, or of one surface, frame by frame."""

    def panel(axes: Axes, plain: Recorded, other: Recorded) -> None:
        for recorded, color in ((plain, _GREY), (other, _BLUE)):
            off = recorded.off_mm
            if surface is not None:
                off = np.where(recorded.truth.surface[..., 0] == surface, off, np.nan)
            seconds = np.arange(len(off)) / recorded.model.recording.frame_rate_hz
            flat = [frame[np.isfinite(frame)] for frame in off]
            values = [np.median(f) if what == "bias" else _spread(f) for f in flat]
            axes.plot(seconds, values, "o", color=color, markersize=2.4)
        axes.set(xlabel="time (s)", ylabel=f"{what} (mm)")
        axes.set_title(f"{what} against time")

    return panel


def _memory(axes: Axes, plain: Recorded, other: Recorded) -> None:
    """Autocorrelation of the noise against lag."""
    lags = np.arange(11)
    for recorded, color in ((plain, _GREY), (other, _BLUE)):
        off = recorded.off_mm[:, np.isfinite(recorded.true_mm)]
        off = off[:, abs(off).max(axis=0) < 10 * off.std(axis=0).mean()]
        e = off / off.std(axis=0)
        axes.plot(lags, [(e[k:] * e[: len(e) - k]).mean() for k in lags], "o", color=color, markersize=4)
    axes.plot(lags, 0.6**lags, color=_INK, linewidth=0.8, zorder=1)
    axes.set(xlabel="lag (frames)", ylabel="correlation")
    axes.set_title("memory of a pixel")


def _one_pixel(axes: Axes, plain: Recorded, other: Recorded) -> None:
    """Deviations of one pixel, frame by frame."""
    for recorded, color in ((plain, _GREY), (other, _BLUE)):
        axes.plot(recorded.off_mm[:, 72, 60], color=color, linewidth=1.0)
    axes.set(xlabel="frame", ylabel="range less truth (mm)")
    axes.set_title("one pixel")


def _histogram(axes: Axes, plain: Recorded, other: Recorded) -> None:
    """Samples of the rows around the mixed pixel of three-boards."""
    edges = np.arange(1800, 6000, 60.0)
    for recorded, color in ((plain, _GREY), (other, _BLUE)):
        samples = recorded.range_mm[:, _MIDDLE_ROW, _MIXED_COL]
        axes.hist(samples / 1000, list(edges / 1000), color=color, alpha=0.6)
    prediction = predict(other.model, seed=SEED)
    pixel = _MIDDLE_ROW * recorded.range_mm.shape[2] + _MIXED_COL
    at = np.broadcast_to(edges[:, np.newaxis], (edges.size, prediction.weight.shape[1]))
    expected = np.diff(prediction.cdf(at)[:, pixel]) * len(other.range_mm)
    axes.plot((edges[1:] + edges[:-1]) / 2000, expected, color=_INK, linewidth=0.8)
    axes.set(xlabel="range (m)", ylabel="samples")
    axes.set_title("one pixel that sees three boards")


def _columns(what: str, limits: tuple[int, int]) -> _Panel:
    """Mean, less that without the effect, or spread along the middle row."""

    def panel(axes: Axes, plain: Recorded, other: Recorded) -> None:
        columns = np.arange(other.range_mm.shape[2])
        without = np.nanmean(plain.range_mm[:, _MIDDLE_ROW], axis=0)
        for recorded, color in ((plain, _GREY), (other, _BLUE)):
            samples = recorded.range_mm[:, _MIDDLE_ROW]
            values = np.nanmean(samples, axis=0) - without if what == "mean" else np.nanstd(samples, axis=0)
            axes.plot(columns, values, "o-", color=color, markersize=2.8, linewidth=0.7)
        axes.set(
            xlabel="column", ylabel="mean less that without (mm)" if what == "mean" else "spread (mm)", xlim=limits
        )
        if what == "spread":
            axes.set_yscale("log")
        axes.set_title(f"{what} along row {_MIDDLE_ROW}, across an edge")

    return panel


def _tails(axes: Axes, plain: Recorded, other: Recorded) -> None:
    """Deviations of all samples, on a logarithmic scale."""
    edges = np.arange(-4000, 4001, 100.0)
    for recorded, color in ((plain, _GREY), (other, _BLUE)):
        counts, _ = np.histogram(recorded.off_mm[np.isfinite(recorded.off_mm)], edges)
        axes.step(edges[:-1] / 1000, np.maximum(counts, 0.5), where="post", color=color)
    axes.set(xlabel="range less truth (m)", ylabel="samples", yscale="log")
    axes.set_title("tails")


def _lattice(axes: Axes, plain: Recorded, other: Recorded) -> None:
    """Stored values in a narrow interval."""
    edges = np.arange(3999.5, 4201.0)
    for recorded, color in ((plain, _GREY), (other, _BLUE)):
        counts, _ = np.histogram(recorded.range_mm, edges)
        axes.step(edges[:-1] + 0.5, counts, where="mid", color=color, linewidth=0.8)
    axes.set(xlabel="stored range (mm)", ylabel="samples", yscale="log")
    axes.set_title("values that occur")


def _folded(axes: Axes, plain: Recorded, other: Recorded) -> None:
    """Recorded against true range."""
    for recorded, color in ((plain, _GREY), (other, _BLUE)):
        axes.plot(recorded.true_mm[::3, ::3].ravel() / 1000, recorded.range_mm[0, ::3, ::3].ravel() / 1000, ".",
                  color=color, markersize=1.5)  # fmt: skip
    axes.set(xlabel="true range (m)", ylabel="recorded range (m)")
    axes.set_title("recorded against true range")


def _frame(axes: Axes, plain: Recorded, other: Recorded) -> None:  # noqa: ARG001  as every panel
    """One frame's image."""
    shown = axes.imshow(other.range_mm[0] / 1000, cmap="viridis", interpolation="nearest")
    axes.figure.colorbar(shown, ax=axes, shrink=0.85, label="range (m)")
    axes.set(xticks=[], yticks=[])
    axes.set_title("one frame")


def _still(axes: Axes, plain: Recorded, other: Recorded) -> None:  # noqa: ARG001  as every panel
    """Pixels without any spread."""
    still = np.nanstd(other.range_mm, axis=0) == 0
    axes.imshow(~still, cmap="gray", interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    axes.set_title(f"pixels without spread: {still.sum()} of {still.size}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Signature:
    """What a picture shows: scene, parameters as TOML, two panels, frame rate."""

    scene: str
    parameters: str
    left: _Panel
    right: _Panel
    rate_hz: float = 25.0
    frames: int = FRAMES


SIGNATURES: dict[str, Signature] = {
    "surface_pose": Signature(
        scene="three-boards", parameters='surface = "middle board"\nshift_mm = 60.0',
        left=_against("range", "bias", surface=1), right=_map("bias"),
    ),
    "motion": Signature(
        scene="slanted-wall", parameters='surface = "board"\nvelocity_mm_s = 50.0',
        left=_over_time("bias", 1), right=_map("bias"),
    ),
    "multipath": Signature(
        scene="corner", parameters='surface = "left wall"\nshare = 0.2\nextra_path_mm = 1500.0',
        left=_against("range", "bias", surface=0), right=_map("bias"),
    ),
    "scattering": Signature(
        scene="near-far", parameters="share = 0.002", left=_against("range", "bias", surface=1), right=_map("bias")
    ),
    "internal_reflection": Signature(
        scene="slanted-wall", parameters="amplitude = 2.0\nrange_mm = 20.0",
        left=_against("range", "bias"), right=_map("bias"),
    ),
    "pixel_crosstalk": Signature(
        scene="near-far", parameters="share = 0.002", left=_columns("mean", (76, 96)),
        right=_columns("spread", (76, 96)),
    ),
    "flying_pixels": Signature(
        scene="three-boards", parameters="probability = 0.5", frames=800, left=_histogram,
        right=_columns("spread", (82, 102)),
    ),
    "vignetting": Signature(
        scene="slanted-wall", parameters="corner_factor = 2.5", left=_against("column", "spread", slice(5, 25)),
        right=_map("ratio"),
    ),
    "wiggling": Signature(
        scene="slanted-wall", parameters="amplitude_mm = 20.0\nphase_rad = 0.3",
        left=_against("range", "bias"), right=_map("bias"),
    ),
    "tap_mismatch": Signature(
        scene="slanted-wall",
        parameters="amplitude_1_mm = 10.0\nphase_1_rad = 0.5\namplitude_2_mm = 15.0\nphase_2_rad = 1.0",
        left=_against("range", "bias"), right=_map("bias"),
    ),
    "temporal_correlation": Signature(
        scene="three-boards", parameters="coefficient = 0.6", left=_memory, right=_one_pixel
    ),
    "interference": Signature(
        scene="three-boards", parameters="probability = 0.2\nsigma_mm = 100.0",
        left=_over_time("spread"), right=_one_pixel,
    ),
    "saturation": Signature(
        scene="slanted-wall", parameters="full_well_amplitude = 100.0",
        left=_against("amplitude", "invalid"), right=_map("invalid"),
    ),
    "phase_wrapping": Signature(
        scene="slanted-wall", parameters="unambiguous_range_mm = 5000.0", left=_folded, right=_frame
    ),
    "range_offset": Signature(
        scene="slanted-wall", parameters="offset_mm = 25.0", left=_against("range", "bias"), right=_over_time("bias")
    ),
    "surface_offset": Signature(
        scene="three-boards", parameters='surface = "middle board"\noffset_mm = 60.0',
        left=_columns("mean", (0, 176)), right=_map("bias"),
    ),
    "temperature_drift": Signature(
        scene="slanted-wall", parameters="amplitude_mm = 30.0\ntime_constant_s = 600.0", rate_hz=0.05,
        left=_over_time("bias"), right=_map("bias"),
    ),
    "smooth_pattern": Signature(
        scene="three-boards", parameters="radial_4_mm = 40.0\nacross_mm = 10.0",
        left=_against("column", "bias"), right=_map("bias"),
    ),
    "fixed_pattern": Signature(
        scene="three-boards", parameters="pixel_sigma_mm = 5.0\ncolumn_sigma_mm = 10.0\nrow_sigma_mm = 5.0",
        left=_against("column", "bias"), right=_map("bias"),
    ),
    "amplitude_walk": Signature(
        scene="slanted-wall", parameters="scale_mm = 20.0\nreference_amplitude = 40.0\nexponent = 0.7",
        left=_against("amplitude", "bias"), right=_map("bias"),
    ),
    "excess_noise": Signature(
        scene="slanted-wall", parameters="factor = 1.5", left=_against("range", "spread"), right=_map("ratio")
    ),
    "near_return": Signature(
        scene="three-boards", parameters="share = 0.06\nrange_mm = 25.0\nsigma_mm = 5.0", left=_tails, right=_frame
    ),
    "outliers": Signature(scene="three-boards", parameters="probability = 0.02", left=_tails, right=_frame),
    "quantisation": Signature(
        scene="slanted-wall", parameters="step_mm = 29.3", left=_lattice, right=_against("range", "spread")
    ),
    "dropout": Signature(
        scene="slanted-wall", parameters="probability = 0.05\nthreshold = 40.0\nthreshold_noise = 8.0",
        left=_against("amplitude", "invalid"), right=_map("invalid"),
    ),
    "stuck_pixels": Signature(
        scene="three-boards", parameters="share = 0.01\nvalue_mm = 6000.0", left=_still, right=_frame
    ),
}  # fmt: skip


def draw(kind: str, plain: Recorded) -> Figure:
    """Draw the picture of one effect."""
    signature = SIGNATURES[kind]
    effect = f'\n[[effect]]\nkind = "{kind}"\n{signature.parameters}\n'
    other = record(signature.scene, effect, frames=signature.frames, rate_hz=signature.rate_hz)
    layout = ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.06)
    figure = Figure(figsize=_SIZE_INCH, dpi=_DPI, layout=layout, facecolor="white")
    shown = signature.parameters.replace("\n", ", ")
    title = fill(f"{kind}: {shown}; scene {signature.scene}", _TITLE_CHARACTERS)
    figure.suptitle(title, x=0.01, ha="left", fontsize=9.0, color=_VERMILLION)
    for axes, panel in zip(figure.subplots(1, 2), (signature.left, signature.right), strict=True):
        panel(axes, plain, other)
    return figure


def main() -> None:
    """Draw the pictures into a folder."""
    parser = argparse.ArgumentParser(description="Draw the signatures of the effects.")
    parser.add_argument("effects", nargs="*", default=list(EFFECTS), help="effects to draw; all of them by default")
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[1] / "images" / "effects")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    plain: dict[tuple[str, float, int], Recorded] = {}
    warnings.filterwarnings("ignore", "All-NaN|Mean of empty|Degrees of freedom")  # pixels that see nothing or much
    with style.context(["default", _SETTINGS]):
        for kind in arguments.effects:
            shown = SIGNATURES[kind]
            key = shown.scene, shown.rate_hz, shown.frames
            if key not in plain:
                plain[key] = record(shown.scene, rate_hz=shown.rate_hz, frames=shown.frames)
            draw(kind, plain[key]).savefig(arguments.output / f"{kind}.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
