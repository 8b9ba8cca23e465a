"""Pixels as short plain text tables for the terminal; for scripts use `PixelView.as_dict`."""

from collections.abc import Mapping

from tofmix.arrays import FloatArray
from tofmix.flags import Mixing, mixing_name
from tofmix.report.pixels.pixels import GrowingDensity, PixelView
from tofmix.wording import counted

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
        lines.append(f"  noise of the pixel: {_own_noise(view)}")
    if view.modes_mm is not None:
        lines.append(f"  peaks of the density (mm): {_listed(view.modes_mm)}")
    return lines


def _layer_line(view: PixelView, k: int) -> str:
    return (
        f"{k + 1:>7}{view.range_mm[k]:>11.2f}{view.range_stderr_mm[k]:>9.2f}{view.weight[k]:>9.4f}"
        f"{view.weight_stderr[k]:>8.4f}{view.sigma_mm[k]:>10.2f}{view.probability[k]:>13.6f}"
    )


def _own_noise(view: PixelView) -> str:
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
