"""Run the stories of `docs/tutorials/measured.md`, put their outputs into the page, and draw its pictures.

Run ``python docs/generators/measured_page.py``. The commands are those of the page: each block of shell commands is run
in one new folder with the clone's `sample_data` and `tests`, and the block of text after it gets what its last command
prints. The same versions of tofmix, NumPy and Matplotlib give the same bytes.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

import tofmix as tm
from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.io.model_file import load_model
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.report.theme import LIGHT, drawing

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/tutorials/measured.md"
BLOCKS = re.compile(r"(```sh\n)(.*?)(```\n\n```text\n)(.*?)(```\n)", re.DOTALL)
WIDTH = 118
"""Longest line of an output."""
LINES = ("verdict", "candidates", "next")
"""The lines that the page shows, the first of each sort, and candidates only where none of them explains the recording.

The sentence above them has the effects and the gap.
"""
_INDENT = 13
"""Column in which the text of a line begins."""
_SIZE_INCH, _DPI = (8.4, 2.7), 150.0
_POINTS = 60
"""Most points of a course: means of frames that follow each other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """Reference and measurement: ranges (frame, row, col), mm, and times (frame,) of the measurement, s."""

    reference_mm: FloatArray
    measured_mm: FloatArray
    time_s: FloatArray

    @property
    def reference_time_s(self) -> FloatArray:
        """Times (frame,) of the reference, s: those just before the measurement."""
        count, step_s = len(self.reference_mm), float(np.median(np.diff(self.time_s)))
        return np.asarray(self.time_s[0] - step_s * np.arange(count, 0, -1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Story:
    """A picture.

    Parameters
    ----------
    folder : str
        Of the outcome, as in the page.
    reference, measured : str
        Recordings; the same one twice if its first frames are the reference.
    """

    folder: str
    reference: str
    measured: str

    def samples(self, root: Path) -> Samples:
        """The samples of both."""
        first, second = (tm.open(root / name) for name in (self.reference, self.measured))
        if not (isinstance(first, tm.Recording) and isinstance(second, tm.Recording)):
            raise TypeError(f"{self.reference}, {self.measured}: not recordings")
        old, new = first.range_mm.astype(np.float64), second.range_mm.astype(np.float64)
        times_s = second.time_s
        if times_s is None:
            raise ValueError(f"{self.measured} has no times")
        if self.reference != self.measured:
            return Samples(reference_mm=old, measured_mm=new, time_s=times_s)
        count = len(new) // 3
        middle_s = float(times_s[:count].mean())
        return Samples(reference_mm=old[:count], measured_mm=new[count:], time_s=times_s[count:] - middle_s)


STORIES = (
    Story(folder="flight", reference="standing.h5", measured="flying.h5"),
    Story(folder="warmth", reference="cold.h5", measured="warm.h5"),
    Story(
        folder="edge",
        reference="sample_data/tmf8829_edge.h5",
        measured="sample_data/tmf8829_edge.h5",
    ),
    Story(
        folder="minutes",
        reference="sample_data/vl53l0x_minute.h5",
        measured="sample_data/vl53l0x_later.h5",
    ),
)


def run(text: str, folder: Path) -> str:
    """The text of the page with the outputs of its commands, which are run in a folder."""
    for name in ("sample_data", "tests"):
        (folder / name).symlink_to(ROOT / name)
    program = f"#!/bin/sh\nexec '{sys.executable}' -m tofmix \"$@\"\n"
    (folder / "bin").mkdir()
    for name, body in (("tofmix", program), ("python", f"#!/bin/sh\nexec '{sys.executable}' \"$@\"\n")):
        (folder / "bin" / name).write_text(body, encoding="utf-8")
        (folder / "bin" / name).chmod(0o755)

    def filled(found: re.Match[str]) -> str:
        before, _, last = found[2].rstrip().rpartition("\n")
        _shell(before, folder)
        return found[1] + found[2] + found[3] + "\n".join(shown(_shell(last, folder))) + "\n" + found[5]

    return BLOCKS.sub(filled, text)


def _shell(commands: str, folder: Path) -> str:
    command = f'PATH="$PWD/bin:$PATH" PYTHONPATH="{ROOT}"; export PATH PYTHONPATH; set -e\n{commands}\n'
    done = subprocess.run(  # noqa: S603  the commands of our own page
        ["/bin/sh", "-c", command], cwd=folder, capture_output=True, text=True, encoding="utf-8", check=False
    )
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{commands}\n{done.stderr}")
    return done.stdout


def shown(output: str) -> Iterator[str]:
    """The lines of an outcome that the page shows."""
    sentence, _, rest = output.partition("\n\n")
    yield from textwrap.wrap(" ".join(sentence.split()), WIDTH)
    yield ""
    first: dict[str, str] = {}
    for line in rest.splitlines():
        first.setdefault(line.split(" ", 1)[0], line)
    explained = first["verdict"].endswith(" explained")
    for sort in LINES:
        if sort in first and not (explained and sort == "candidates"):
            text = first[sort].removeprefix(sort).strip()
            begin = sort.ljust(_INDENT)
            yield from textwrap.wrap(text, WIDTH, initial_indent=begin, subsequent_indent=" " * _INDENT)


def draw(story: Story, root: Path) -> Figure:
    """Where the last frames differ from the reference, and how the pixels that differ do in time."""
    samples, model = story.samples(root), load_model(str(root / story.folder / "model.toml"))
    if model.scene is None:
        raise ValueError(f"{story.folder}: the model has no measured scene")
    one = (model.scene.share > 0).sum(axis=-1) == 1
    used = model.scene.known & ~model.scene.beside_others & one
    base = _level(samples.reference_mm)
    last = _level(samples.measured_mm[-max(len(samples.measured_mm) // 3, 1) :])
    change = np.where(used, last - base, np.nan)
    most = float(np.nanpercentile(np.abs(change), 98.0))
    differs = _on_changed_surfaces(change, model.scene.surface[..., 0].astype(np.int64))
    figure = Figure(figsize=_SIZE_INCH, dpi=_DPI, layout=ConstrainedLayoutEngine(w_pad=0.1))
    if change.size > 1:
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.7))
        image = left.imshow(change, cmap="PuOr", vmin=-most, vmax=most, interpolation="nearest")
        figure.colorbar(image, ax=left, label="change (mm)", shrink=0.85)
        left.set(xticks=[], yticks=[])
        left.set_title("last third less reference", loc="left", fontsize=9.5)
    else:
        right = figure.subplots()
    _draw_course(right, samples, base, differs)
    if _effects(root / story.folder):
        seen = Scene(model, samples.time_s).mixture(()).main_means(np.flatnonzero(differs))
        right.plot(
            samples.time_s,
            np.nanmedian(seen - base[differs], axis=1),
            color=LIGHT.ink,
            linewidth=1.2,
            label="the written model",
        )
    right.legend(frameon=False, fontsize=8.5)
    right.set_title(
        "median of the surfaces that changed" if change.size > 1 else "means of 55 ranges", loc="left", fontsize=9.5
    )
    return figure


def _level(range_mm: FloatArray) -> FloatArray:
    """The range (row, col) of pixels of an image: medians, which random values do not move. Of one pixel the mean."""
    return np.asarray(np.nanmedian(range_mm, axis=0) if range_mm[0].size > 1 else np.nanmean(range_mm, axis=0))


def _on_changed_surfaces(change: FloatArray, surface: IntArray) -> BoolArray:
    """Pixels (row, col) of the surfaces whose median change is more than half of the largest one.

    A choice pixel by pixel would prefer those whose noise is on the side of the change.
    """
    used = np.isfinite(change)
    median = {k: abs(float(np.median(change[used & (surface == k)]))) for k in np.unique(surface[used])}
    chosen = [k for k, size in median.items() if size > max(median.values()) / 2]
    return np.asarray(used & np.isin(surface, chosen))


def _effects(folder: Path) -> list[dict[str, object]]:
    """The named effects of an outcome."""
    found: list[dict[str, object]] = json.loads((folder / "gap.json").read_text(encoding="utf-8"))["effects"]
    return found


def _draw_course(axes: Axes, samples: Samples, base: FloatArray, pixels: BoolArray) -> None:
    """Draw the median change of some pixels against time, in the reference and after."""
    parts = (
        ("reference", samples.reference_mm, samples.reference_time_s, LIGHT.hatch),
        ("measured", samples.measured_mm, samples.time_s, LIGHT.accent),
    )
    for label, range_mm, time_s, colour in parts:
        middle = np.nanmedian((range_mm - base)[:, pixels], axis=1)
        blocks = np.array_split(np.arange(len(middle)), min(len(middle), _POINTS))
        x, y = (np.array([np.nanmean(values[block]) for block in blocks]) for values in (time_s, middle))
        axes.plot(x, y, "o", color=colour, markersize=3.5, label=label)
    axes.axhline(0.0, color=LIGHT.grid, linewidth=0.8, zorder=0)
    axes.set(xlabel="time (s)", ylabel="change (mm)")


def main() -> None:
    """Run the stories, and write page and pictures."""
    parser = argparse.ArgumentParser(description="Write docs/tutorials/measured.md again, and its pictures.")
    parser.add_argument("--images", type=Path, default=ROOT / "docs/images", help="folder to write pictures to")
    parser.add_argument("--page", type=Path, default=PAGE, help="page to write")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options.page.write_text(run(PAGE.read_text(encoding="utf-8"), folder), encoding="utf-8")
        for story in STORIES:
            with drawing(LIGHT):
                path = options.images / f"measured_{story.folder}.png"
                draw(story, folder).savefig(path, metadata={"Software": None})


if __name__ == "__main__":
    main()
