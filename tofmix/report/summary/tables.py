"""A summary as a short plain text table for the terminal.

For scripts use `Summary.as_dict`. ASCII only and at most 80 columns, for any terminal.
"""

import textwrap

from tofmix.report.summary.quantiles import Quantiles
from tofmix.report.summary.summary import LayerSummary, Summary
from tofmix.suspicion import SUSPICIONS
from tofmix.wording import counted, number, percent_of

COLUMNS = 80
"""Characters of a line: the width of a terminal."""

MAX_ROWS = 5
"""Rows for surfaces and for layers; the last one holds the rest."""

ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth")


def ordinal(layer: int) -> str:
    """``first`` for 1 up to ``sixth``, then ``layer 7`` and so on."""
    return ORDINALS[layer - 1] if layer <= len(ORDINALS) else f"layer {layer}"


def format_table(summary: Summary) -> str:
    """Format a summary: about 25 lines of at most 80 ASCII characters, but for commands; no newline at the end."""
    lines = [
        *_head(summary),
        "",
        *_surfaces(summary),
        "",
        *_layers(summary),
        *_suspects(summary),
        "",
        *_status(summary),
    ]
    for finding in (*summary.warnings, *summary.notes):
        kind = "note" if finding.is_note else "warning"
        lines += textwrap.wrap(f"{kind}: {finding.text}", COLUMNS, subsequent_indent="  ")
        lines += [f"  try: {printable(command, 1000)}" for command in finding.commands]  # whole, to be copied
    return "\n".join(lines)


def printable(text: str, width: int = 64) -> str:
    """Return ASCII text safe for a terminal: other characters escaped, cut to `width` with dots."""
    safe = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    safe = safe.encode("ascii", "backslashreplace").decode()
    return safe if len(safe) <= width else f"{safe[: width - 3]}..."


def _head(summary: Summary) -> list[str]:
    windows = f"{summary.windows} of {counted(summary.window_frames, 'frame')}"
    if summary.frames_left_out:
        windows += f"; {counted(summary.frames_left_out, 'frame')} left out at the end"
    head = [
        f"source     {printable(summary.source)}",
        f"windows    {windows}",
        f"pixels     {summary.pixels} ({counted(summary.rows, 'row')} x {counted(summary.cols, 'column')} a window)",
        f"samples    {number(summary.samples.q50, '.0f')} valid a pixel (median)",
    ]
    if summary.lost is not None:
        head.append(f"lost       {summary.lost.line}")
    if summary.noise is not None:
        indent = " " * len("samples    ")
        head += textwrap.wrap(f"noise      {summary.noise.line}", COLUMNS, subsequent_indent=indent)
    if summary.mixing is not None:
        indent = " " * len("samples    ")
        kinds = ", ".join(f"{name} {count:,}" for name, count in summary.mixing.pixels.items())
        text = f"mixing     {summary.mixing.line}; pixels: {kinds}"
        head += textwrap.wrap(text, COLUMNS, subsequent_indent=indent)
    return head


def _surfaces(summary: Summary) -> list[str]:
    lines = [f"{'surfaces':<16}{'pixels':>10}{'share':>9}{'counted by peaks':>20}"]
    by_surfaces, by_peaks = _folded(summary.decided_by_surfaces), _folded(summary.pixels_by_peaks)
    shown = max((n for n in range(MAX_ROWS) if by_surfaces[n] or by_peaks[n]), default=0)
    for n in range(shown + 1):
        name = f"{n} or more" if n == MAX_ROWS - 1 else f"{n}"
        lines.append(f"{name:<16}{by_surfaces[n]:>10}{percent_of(by_surfaces[n], summary.pixels):>9}{by_peaks[n]:>20}")
    several = sum(summary.decided_by_surfaces[2:])
    lines.append(f"{'more than one':<16}{several:>10}{percent_of(several, summary.pixels):>9}")
    if undecided := sum(summary.undecided_by_surfaces):
        lines.append(f"{'undecided':<16}{undecided:>10}{percent_of(undecided, summary.pixels):>9}  not counted above")
    return lines


def _suspects(summary: Summary) -> list[str]:
    """A line for each suspicion that marks a layer, after an empty one."""
    layers = sum(layer.count for layer in summary.layers)
    marked = [(suspicion.short, summary.layers_by_suspicion[suspicion.name]) for suspicion in SUSPICIONS]
    lines = [f"{short:<24}{count:>10}{percent_of(count, layers):>9}" for short, count in marked if count]
    return ["", f"{'suspect':<24}{'layers':>10}{'share':>9}", *lines] if lines else []


def _layers(summary: Summary) -> list[str]:
    lines = [
        f"{'':<8}{'':>9}{'range, mm':>22}{'':>9}{'stderr':>9}{'sigma':>8}{'sigma /':>9}",
        f"{'layer':<8}{'pixels':>9}{'5 %':>8}{'median':>8}{'95 %':>8}{'share':>8}{'mm':>8}{'mm':>8}{'curve':>9}",
    ]
    lines += [_layer(layer) for layer in summary.layers[:MAX_ROWS] if layer.count or layer.layer == 1]
    more = sum(layer.count for layer in summary.layers[MAX_ROWS:])
    if more:
        lines.append(f"and {counted(more, 'component')} in further layers")
    no_return = summary.weight_no_return
    lines.append(f"{'no return':<9}{no_return.count:>8}{_triple(no_return, '.3f')}  share without a return")
    if summary.options.get("sigma") == "tied":
        lines.append("sigma is tied to the curve, so it does not test the curve")
    return lines


def _layer(layer: LayerSummary) -> str:
    return (
        f"{ordinal(layer.layer):<8}{layer.count:>9}{_triple(layer.range_mm, '.0f')}"
        f"{number(layer.weight_median, '.3f'):>8}{number(layer.range_stderr_median_mm, '.2f'):>8}"
        f"{number(layer.sigma_median_mm, '.1f'):>8}{number(layer.sigma_over_curve_median, '.3f'):>9}"
    )


def _status(summary: Summary) -> list[str]:
    lines = [f"{'status':<16}{'pixels':>10}{'share':>9}"]
    for name, count in summary.pixels_by_status.items():
        if count or name == "ok":
            lines.append(f"{name:<16}{count:>10}{percent_of(count, summary.pixels):>9}")
    return lines


def _folded(counts: tuple[int, ...]) -> list[int]:
    """`MAX_ROWS` counts, the last one with all that follow."""
    padded = [*counts, *[0] * MAX_ROWS]
    return [*padded[: MAX_ROWS - 1], sum(padded[MAX_ROWS - 1 :])]


def _triple(quantiles: Quantiles, form: str) -> str:
    return "".join(f"{number(q, form):>8}" for q in (quantiles.q05, quantiles.q50, quantiles.q95))
