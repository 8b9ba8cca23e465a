"""The note on fewer frames than README asks for: when it is made, and that its figures are those of docs/results."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tofmix.flags import MixingLaw
from tofmix.layers import Layers
from tofmix.report.sources import LayersSource
from tofmix.report.summary.findings import PHASOR_SUMS, SINGLE_SAMPLES, AskedFrames, Remedy, frame_findings
from tofmix.report.summary.summary import summarise

ROOT = Path(__file__).parents[3]


def column(page: str, head: str) -> dict[int, float]:
    """A column of the table of a page's section "By number of frames": figures by frames."""
    section = (ROOT / page.partition("#")[0]).read_text(encoding="utf-8").partition("### By number of frames")[2]
    lines = re.findall(r"^\|.*\|$", section, re.MULTILINE)
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    place = table[0].index(head)
    rows = table[2:]
    last = next((k for k, row in enumerate(rows) if not row[0].isdigit()), len(rows))
    return {int(row[0]): float(row[place]) for row in rows[:last]}


@pytest.mark.parametrize(
    ("asked", "head"), [(SINGLE_SAMPLES, "0.2, 4 sigma"), (PHASOR_SUMS, "exactly both")], ids=["samples", "sums"]
)
def test_figures_are_those_of_the_table_up_to_the_frames_asked_for(asked: AskedFrames, head: str) -> None:
    table = column(asked.page, head)
    assert len(table) > len(asked.found) >= 4
    assert dict(asked.found) == {frames: figure for frames, figure in table.items() if frames <= asked.frames}
    assert max(asked.found) == asked.frames
    assert list(asked.found.values()) == sorted(asked.found.values())


def test_frames_asked_for_are_those_of_readme() -> None:
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"{SINGLE_SAMPLES.frames} or more ({PHASOR_SUMS.frames} where light adds up)" in text


@pytest.mark.parametrize(("sums", "least"), [(False, 25), (True, 10)])
def test_a_note_is_made_below_the_frames_asked_for_alone(sums: bool, least: int) -> None:
    def made(frames: int) -> list[str]:
        remedy = Remedy(recording="a.h5", window_frames=frames)
        return [finding.code for finding in frame_findings(sums=sums, total=frames, remedy=remedy)]

    assert made(least) == made(4000) == []
    assert made(least - 1) == made(1) == ["few_frames"]


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (7, "33 % are found with 7 frames"),
        (11, "less than 73 % are found with 11 frames"),
        (1, "before another, 0 % are found with 1 frame,"),
    ],
)
def test_the_figure_is_that_of_the_row_or_below_the_next_one(frames: int, said: str) -> None:
    (finding,) = frame_findings(sums=False, total=frames, remedy=Remedy(recording="a.h5", window_frames=frames))
    assert said in finding.text
    assert f"{frames} frame{'s' * (frames > 1)} a window; tofmix asks for 25 or more." in finding.text
    assert "and 93 % with 25 (docs/results/limits.md#by-number-of-frames)" in finding.text
    assert finding.is_note


@pytest.mark.parametrize(("total", "window"), [(18, "18"), (25, "25"), (900, "25")])
def test_a_longer_window_is_advised_where_the_recording_has_frames(total: int, window: str) -> None:
    (finding,) = frame_findings(sums=False, total=total, remedy=Remedy(recording="a.h5", window_frames=9))
    assert finding.commands == (f"tofmix estimate a.h5 --window {window} --overwrite",)
    assert "Record more" not in finding.text


def test_more_frames_are_asked_for_where_the_window_is_the_whole_recording() -> None:
    (finding,) = frame_findings(sums=True, total=6, remedy=Remedy(recording="a.h5", window_frames=6))
    assert finding.commands == ()
    assert finding.text.endswith(
        "less than 99.9 % are found with 6 frames, and 99.9 % with 10"
        " (docs/results/mixing.md#by-number-of-frames). Record more frames."
    )


@pytest.mark.parametrize(
    ("options", "share", "asked"),
    [
        ({"mixing": "auto"}, 0.05, 10),
        ({"mixing": "auto"}, 0.04, 25),
        ({"mixing": "auto"}, math.nan, 25),
        ({"mixing": "phasor"}, math.nan, 10),
    ],
)
def test_the_law_of_mixing_or_the_option_settles_which_frames_are_asked_for(
    make_layers: Callable[..., Layers],
    make_source: Callable[..., LayersSource],
    options: dict[str, str],
    share: float,
    asked: int,
) -> None:
    source = replace(
        make_source(make_layers(), options={"window": 9} | options),
        frames=9,
        law=MixingLaw(phasor_share=share, pixels=70),
    )  # type: ignore[type-var]
    (note,) = summarise(source).notes
    assert f"9 frames a window; tofmix asks for {asked} or more." in note.text
