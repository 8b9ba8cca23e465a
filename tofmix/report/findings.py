"""What a reader of a layers file should be wary of, in one sentence each.

A finding says what was seen and what to try. The thresholds are for drawing
attention, not tests: nothing is refused here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tofmix.flags import Status, status_name

SIGMA_TOLERANCE = 0.10
"""Relative difference of median sigma and curve that is worth a word."""

STATUS_SHARE = 0.05
"""Share of pixels with one unwelcome status that is worth a word."""

FULL_SHARE = 0.05
"""Share of pixels that use every layer that is worth a word."""

CLOSE_SIGMAS = 5.0
CLOSE_SHARE = 0.05
"""Share of pixels with two layers this near to each other, in sigmas, that is worth a word."""

MIN_COMPONENTS = 30
"""Fewer components than this say nothing of the curve."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One warning: `code` is stable and for scripts, `text` for people."""

    code: str
    text: str


_STATUS_TEXTS: dict[Status, str] = {
    Status.TOO_FEW_SAMPLES: "have too few valid samples and were not fitted; a longer --window has more",
    Status.NOT_CONVERGED: "did not converge; raise --max-iter, or take their layers as rough",
    Status.DEGENERATE: "have layers whose errors the samples cannot tell; take their range_stderr as unknown",
}


def count_findings(
    *, pixels: int, by_status: Mapping[str, int], by_surfaces: Sequence[int], max_layers: int, close: int = 0
) -> list[Finding]:
    """List what the counts of pixels say.

    Parameters
    ----------
    pixels : int
        Pixels over all windows.
    by_status : mapping of str to int
        Pixels of each status name.
    by_surfaces : sequence of int
        Pixels with 0, 1, 2, ... surfaces.
    max_layers : int
        Layers that the file can hold.
    close : int
        Pixels with two layers within `CLOSE_SIGMAS` of each other.

    Returns
    -------
    list of Finding
        Empty if all is well.
    """
    found = []
    for status, text in _STATUS_TEXTS.items():
        share = by_status.get(status_name(status), 0) / max(1, pixels)
        if share > STATUS_SHARE:
            found.append(Finding(code=status_name(status), text=f"{100 * share:.1f} % of the pixels {text}."))
    full = sum(by_surfaces[max_layers:]) / max(1, pixels)
    if max_layers > 1 and full > FULL_SHARE:
        text = f"{100 * full:.1f} % of the pixels use all {max_layers} layers; a larger --max-layers may find more."
        found.append(Finding(code="all_layers_used", text=text))
    if close / max(1, pixels) > CLOSE_SHARE:
        text = (
            f"{100 * close / pixels:.1f} % of the pixels have two layers within {CLOSE_SIGMAS:g} sigma of each other."
            " Few scenes look like that; a noise curve that is too small, or drift within the window, does."
        )
        found.append(Finding(code="close_layers", text=text))
    if pixels and pixels == sum(by_surfaces[:1]):
        found.append(Finding(code="no_surface_anywhere", text="No pixel shows a surface."))
    return found


def target_findings(targets: int) -> list[Finding]:
    """Say what a share is of, where pixels return several targets a frame; `targets` is 0 where they do not."""
    if not targets:
        return []
    text = (
        f"Pixels return up to {targets} targets a frame, all of which are their samples: a share is a share of"
        " detections."
    )
    return [Finding(code="shares_of_detections", text=text)]


def sigma_findings(*, count: int, median: float | None, has_curve: bool) -> list[Finding]:
    """List what sigma says of the sensor's noise curve.

    Parameters
    ----------
    count, median : int, float or None
        Components compared, and the median of their sigma over the curve.
    has_curve : bool
        Whether there is a curve.

    Returns
    -------
    list of Finding
        Empty if all is well.
    """
    if not has_curve:
        return [Finding(code="no_noise_curve", text="The file has no noise curve, so sigma is compared with nothing.")]
    if median is None or count < MIN_COMPONENTS or abs(median - 1.0) <= SIGMA_TOLERANCE:
        return []
    text = (
        f"Sigma is {median:.2f} times the sensor's curve (median): the noise curve and the recording disagree; "
        "measure the curve from the recording."
    )
    return [Finding(code="sigma_off_curve", text=text)]
