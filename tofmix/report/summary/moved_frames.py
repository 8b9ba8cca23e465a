"""Frames of two kinds in words: in some frames nearly all pixels read farther, or nearer, than in the others.

Marks of layers tell it (`tofmix.suspicion.frame_kinds`). The recording, where it is at hand, tells which frames.
"""

import json
import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.layers import Layers
from tofmix.recording import SampleSource, samples_a_frame
from tofmix.report.summary.findings import Finding, Remedy
from tofmix.suspicion.frame_kinds import LEAST_SHARE, NOISE_SIGMAS
from tofmix.suspicion.passing import PASSING
from tofmix.suspicion.scene import LEAST_PIXELS
from tofmix.wording import counted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovedFrames:
    """Frames of a window in which nearly all pixels show a layer that they do not show in the others."""

    start: int  # first frame of the window
    stop: int  # one past its last frame
    first: int  # first one of these frames
    last: int  # last one of these frames
    displacement_mm: float  # how much farther pixels read in them, median over pixels
    share: float  # part of the window's frames, median over pixels
    place: tuple[IntArray, IntArray]  # rows, columns of the pixels
    range_mm: FloatArray  # (pixel, layer) of their layers
    is_moved: BoolArray  # (pixel, layer), of those layers that these frames show


Frames = Callable[[MovedFrames], IntArray]
"""Tells the numbers of moved frames."""


def find_moved(window: Layers, start: int, stop: int) -> list[MovedFrames]:
    """The frames of a window (row, col) of frames [start, stop) that nearly all pixels show as moved, by kind."""
    if window.suspect is None or window.suspect_frames is None:
        return []
    marked = (window.suspect & PASSING.flag) > 0
    seen = int((window.n_modes > 0).sum())
    ends, kind = np.unique(window.suspect_frames[marked], axis=0, return_inverse=True)
    of_layer = np.full(marked.shape, -1)
    of_layer[marked] = kind.ravel()
    still = np.where(marked, np.nan, window.range.astype(np.float64))
    out = []
    for number, (first, last) in enumerate(ends.tolist()):
        of_kind = of_layer == number
        place = np.nonzero(of_kind.any(axis=-1) & np.isfinite(still).any(axis=-1))
        least = max(LEAST_SHARE * seen, LEAST_PIXELS)
        if len(place[0]) < least:
            continue
        pixel, layer = np.nonzero(of_kind[place])
        moved = window.range[place][pixel, layer].astype(np.float64)
        beside = np.nanargmin(np.abs(still[place][pixel] - moved[:, None]), axis=-1)
        apart = moved - still[place][pixel, beside]
        displacement = float(np.median(apart))
        noise = np.hypot(*(window.sigma[place][pixel, of] for of in (layer, beside)))
        if len(np.unique(pixel[np.abs(apart - displacement) <= NOISE_SIGMAS * noise])) < least:
            continue  # something passed before all pixels
        share, other = (window.weight[place][pixel, of] for of in (layer, beside))
        out.append(
            MovedFrames(
                start=start,
                stop=stop,
                first=int(first),
                last=int(last),
                displacement_mm=displacement,
                share=float(np.median(share / (share + other))),
                place=(place[0], place[1]),
                range_mm=window.range[place].astype(np.float64),
                is_moved=of_kind[place],
            )
        )
    return out


def moved_frames(
    source: SampleSource,
    moved: MovedFrames,
    *,
    most_rows: int = 16,  # of which samples are read
) -> IntArray:
    """The numbers of the frames: those in which the samples of most pixels are nearest to layers of these frames."""
    each, (row, col) = samples_a_frame(source), moved.place
    rows = np.unique(row)
    votes = np.zeros(moved.stop - moved.start, np.int64)
    for number in rows[np.linspace(0, len(rows) - 1, min(len(rows), most_rows)).astype(int)]:
        chosen = row == number
        part = slice(int(number), int(number) + 1)
        samples = source.read_range(slice(moved.start * each, moved.stop * each), part)[:, 0, col[chosen]]
        away = np.abs(samples[..., None] - moved.range_mm[chosen])
        nearest = np.where(np.isfinite(away), away, np.inf).argmin(axis=-1)
        is_moved = np.take_along_axis(moved.is_moved[chosen][None], nearest[..., None], axis=-1)[..., 0]
        votes += (np.where(is_moved, 1, -1) * np.isfinite(samples)).reshape(len(votes), -1).sum(axis=1)
    return np.asarray(moved.start + np.flatnonzero(votes > 0))


def moved_findings(
    found: list[list[MovedFrames]], remedy: Remedy, frames: Frames | None, *, targets: int = 0
) -> list[Finding]:
    """Say that frames are of two kinds, or more: `found` are those of each window that has any.

    The first window is told. `frames` tells the numbers of frames, where the recording is at hand; `targets` are those
    that its pixels return in a frame, if several.
    """
    if not found:
        return []
    kinds = [None if frames is None else frames(moved) for moved in found[0]]
    said = [_said(moved, numbers) for moved, numbers in zip(found[0], kinds, strict=True)]
    start, stop = found[0][0].start, found[0][0].stop
    text = (
        f"In {'; in '.join(said)}: frames of {'two' if len(said) == 1 else 'several'} kinds, not a further surface"
        " (another exposure or frequency, a camera that moved, or something before all of its view)."
    )
    if remedy.windows > 1:
        text += f" So in {len(found)} of {remedy.windows} windows; these are frames {start} to {stop - 1}."
    text += " Estimate the frames of each kind by themselves."
    whole = remedy.windows == 1 and len(said) == 1 and kinds[0] is not None
    commands = _commands(kinds[0], stop, remedy) if whole and kinds[0] is not None and not targets else ()
    return [Finding(code="frames_of_two_kinds", text=text, commands=commands)]


def _said(moved: MovedFrames, frames: IntArray | None) -> str:
    total = moved.stop - moved.start
    count = round(moved.share * total) if frames is None else len(frames)
    which = f"from frame {moved.first} to {moved.last}" if frames is None else _frames_words(frames)
    away = f"{round(abs(moved.displacement_mm), 1):g} mm {'farther' if moved.displacement_mm > 0.0 else 'nearer'}"
    return f"{count} of {counted(total, 'frame')} nearly all pixels read {away} than in the others ({which})"


def _step(frames: IntArray) -> int | None:
    """The common step of more than two numbers; None without one."""
    steps = np.unique(np.diff(frames))
    return int(steps[0]) if len(steps) == 1 and len(frames) > 2 else None  # noqa: PLR2004  two are always evenly spaced


def _frames_words(frames: IntArray) -> str:
    """Numbers of frames in words."""
    step = _step(frames)
    if step == 1:
        return f"frames {frames[0]} to {frames[-1]}"
    if step is not None:
        return f"every {_ordinal(step)} frame, from frame {frames[0]} on"
    few = 5  # numbers that are listed
    listed = [str(number) for number in frames.tolist()]
    if len(listed) > few:
        listed[few - 1 : -1] = ["..."]
    return f"{'frames' if len(listed) > 1 else 'frame'} {', '.join(listed)}"


def _ordinal(number: int) -> str:
    teens = 11 <= number % 100 <= 13  # noqa: PLR2004  eleventh, twelfth, thirteenth
    ending = "th" if teens else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"


def _commands(frames: IntArray, total: int, remedy: Remedy) -> tuple[str, ...]:
    """The command whose windows are of one kind each, else the one that writes the other frames as a recording."""
    step, first, last = _step(frames), int(frames[0]), int(frames[-1])
    if step == 1:
        window = math.gcd(first, last + 1, total)
        least = 10  # frames: shorter windows find little
        if window >= least:
            return (remedy.command("--window", str(window)),)
    most = 30  # numbers of frames in a command
    if step is None and len(frames) > most:
        return ()
    chosen = str(frames.tolist()) if step is None else f"np.s_[{first}:{last + 1}:{step}]"
    light = ", amplitude=others(r.amplitude)" if remedy.has_amplitude else ""
    names = (remedy.recording, str(Path(remedy.recording).with_suffix(".others.h5")))
    before, after = (json.dumps(name, ensure_ascii=False) for name in names)  # the shell quotes code by single quotes
    code = (
        f"import numpy as np, tofmix; r = tofmix.open({before}); others = lambda a: np.delete(a, {chosen}, 0);"
        f' tofmix.from_array(others(r.range_mm), units="mm", sensor=r.sensor{light}).save({after})'
    )
    return (shlex.join(["python", "-c", code]),)
