"""The page of a reconciliation: what it says and shows, with an effect and without one."""

import re
from dataclasses import replace

import pytest
from support.recordings import reconciled

from tofmix.reconciliation.workflow import Reconciliation
from tofmix.report.gap import render_gap
from tofmix.sensors import load_profile
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface

MODEL = Model(
    sensor=replace(load_profile("sr4000"), rows=12, cols=16),
    surfaces=(
        Surface(name="<board>", center_mm=(-300.0, 0.0, 1500.0), size_mm=(500.0, 500.0)),
        Surface(name="wall", center_mm=(0.0, 0.0, 3000.0), size_mm=(9000.0, 9000.0), yaw_deg=20.0),
    ),
    recording=RecordingSettings(frames=60),
)


@pytest.fixture(scope="module")
def explained() -> Reconciliation:
    """The outcome for a hidden offset of 9 mm."""
    return reconciled(MODEL, RangeOffset(offset_mm=9.0), kinds=("range_offset", "surface_pose"))


@pytest.fixture(scope="module")
def page(explained: Reconciliation) -> str:
    return render_gap(explained, source="my <recording>.h5")


def _titles(page: str) -> list[str]:
    return re.findall(r"<h3>(.*?)</h3>", page)


@pytest.mark.slow
def test_page_names_the_missing_effect_and_its_place(page: str) -> None:
    assert "my &lt;recording&gt;.h5" in page
    assert "<board>" not in page
    for words in ("Verdict: explained", "What was missing", "Where they disagree", "Candidates", "Panel"):
        assert words in page
    (added,) = re.findall(r"<pre>(.*?)</pre>", page, re.DOTALL)
    assert 'kind = "range_offset"' in added.replace("&#34;", '"')
    fitted = re.search(r"<td>range_offset</td><td class=\"fitted\">offset_mm (.*?)</td>", page)
    assert fitted is not None
    assert float(fitted[1]) == pytest.approx(9.0, abs=0.5)
    assert re.search(r'(src|srcset|href)="(?!data:)', page) is None


@pytest.mark.slow
def test_page_shows_the_weighed_sets_with_the_answer_first(page: str, explained: Reconciliation) -> None:
    (table,) = re.findall(r'<table class="weighed">(.*?)</table>', page, re.DOTALL)
    rows = re.findall(r"<tr><td>(.*?)</td><td>(.*?)</td><td>(.*?)</td></tr>", table)
    assert [row[0] for row in rows[:1]] == ["range_offset"]
    assert rows[0][2] == "the answer"
    assert [row[2] for row in rows[1:]] == [w.why_not for w in explained.considered[1:]]
    assert len(rows) == len(explained.considered) > 1


@pytest.mark.slow
def test_pictures_show_the_largest_disagreements_and_each_statistic(page: str, explained: Reconciliation) -> None:
    curves = [title for title in _titles(page) if " against " in title]
    places = [f"{p.statistic} against {p.axis}" for p in explained.where if p.axis != "all"]
    assert curves[:4] == [place.replace("_", " ") for place in places[:4]]
    shown = {title.split(" against ")[0] for title in curves}
    assert {"bias", "spread", "skew", "tails", "trend", "common mode", "memory"} <= shown
    assert "discreteness against period" in curves
    assert re.search(rf'alt="{curves[0]}: \d+\.\d times noise alone before, \d\.\d after"', page) is not None
