"""Notes on recordings of fewer frames than README asks for, with what is lost.

The figures are those of two tables by number of frames, and stand here alone in the code;
`tests/report/summary/test_frames.py` holds them to the tables.
"""

from dataclasses import dataclass
from types import MappingProxyType

from tofmix.report.summary.findings import Finding, Remedy
from tofmix.wording import counted


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedFrames:
    """Frames that README asks for, and the share found with fewer.

    Parameters
    ----------
    frames : int
        Frames that are asked for.
    found : mapping of int to float
        Share found by number of frames, ascending in both, up to `frames`.
    what : str
        What is found, in words.
    page : str
        The page with the table.
    """

    frames: int
    found: MappingProxyType[int, float]
    what: str
    page: str

    def finding(self, remedy: Remedy, total: int) -> list[Finding]:
        """A note if the windows of an estimate are shorter; `total` is the recording's number of frames.

        What is found with fewer frames than a row of the table is less than the row says.
        """
        window = remedy.window_frames
        if window >= self.frames:
            return []
        row = min(frames for frames in self.found if frames >= window)
        least = "less than " if row > window and self.found[row] > 0 else ""
        most = f"{least}{100 * self.found[row]:.3g} %"
        text = (
            f"{counted(window, 'frame')} a window; tofmix asks for {self.frames} or more. Of {self.what}, {most} are"
            f" found with {counted(window, 'frame')}, and {100 * self.found[self.frames]:.3g} % with {self.frames}"
            f" ({self.page})."
        )
        longer = total > window
        commands = (remedy.command("--window", str(min(total, self.frames))),) if longer else ()
        text += "" if longer else " Record more frames."
        return [Finding(code="few_frames", text=text, commands=commands, is_note=True)]


SINGLE_SAMPLES = AskedFrames(
    frames=25,
    found=MappingProxyType({3: 0.00, 5: 0.18, 7: 0.33, 10: 0.52, 15: 0.73, 20: 0.86, 25: 0.93}),
    what="surfaces with a fifth of a pixel's samples, 4 sigma before another",
    page="docs/results/limits.md#by-number-of-frames",
)
"""Where each sample is of one surface."""

PHASOR_SUMS = AskedFrames(
    frames=10,
    found=MappingProxyType({3: 0.998, 5: 0.998, 7: 0.999, 10: 0.999}),
    what="pixels with two surfaces far apart, whose light adds up",
    page="docs/results/mixing.md#by-number-of-frames",
)
"""Where samples are phasor sums."""


def frame_findings(*, sums: bool, total: int, remedy: Remedy) -> list[Finding]:
    """Say that the windows have fewer frames than README asks for.

    Parameters
    ----------
    sums : bool
        Whether samples at edges are phasor sums.
    total : int
        Frames of the recording.
    remedy : Remedy
        The estimate.
    """
    return (PHASOR_SUMS if sums else SINGLE_SAMPLES).finding(remedy, total)
