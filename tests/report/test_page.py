import base64
import hashlib
import io
import re
import sys
from dataclasses import is_dataclass, replace
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image
from support.alike import MakeLayers, MakeRecording, MakeSource

from tofmix.errors import UsageError
from tofmix.flags import Mixing, MixingLaw, Status
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.report.page import headline, page_script, render_page
from tofmix.report.summary.summary import summarise
from tofmix.sensor import Sensor

VOID = {"meta", "img", "source", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Tags, attributes and text of a page; fails on tags that do not pair."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.scripts: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in ("style", "script"):
            self.text += data
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.tags if name == tag]


def check_page(text: str) -> Page:
    """Check what holds for every page."""
    page = Page(text)
    for image in page.all("img"):
        assert len(image["alt"] or "") > 20
        assert (image["src"] or "").startswith("data:image/")
    for _, attrs in page.tags:
        for name in ("src", "href", "srcset"):
            assert (attrs.get(name) or "data:").startswith("data:")
    assert "@import" not in text
    data, script = page.scripts
    outside = text.replace(data, "").replace(script, "")
    assert "url(" not in outside
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", outside), re.IGNORECASE)
    assert page.all("script") == [{"type": "application/json", "id": "explorer-data"}, {}]
    assert script == page_script()
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = next(a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'" == policy
    assert "<" not in data
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'byId\("([^"]+)"\)', script)) <= set(ids)
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))
    assert {"viewport", "color-scheme"} <= {a.get("name") for a in page.all("meta")}
    return page


def test_a_page_holds_every_picture_with_its_words(
    make_layers: MakeLayers, make_source: MakeSource, make_recording: MakeRecording
) -> None:
    text = render_page(make_source(make_layers()), recording=make_recording())
    page = check_page(text)
    assert len(page.all("img")) == 8
    assert len(page.all("source")) == 4  # counts and histograms; ranges have the same colours on a dark ground
    assert len(page.all("figure")) == 11
    for word in ("Averaged image", "First layer", "Second layer", "Third layer", "Number of surfaces", "Section"):
        assert word in page.text
    assert page.text.count("Good") == page.text.count("Bad") == 11
    assert "phasor mean of the samples" in page.text
    assert "Mixing" not in page.text
    assert "gamma" in page.text
    assert "ab" * 32 in page.text


def test_names_are_escaped_and_unknown_sensors_shown(make_layers: MakeLayers, make_source: MakeSource) -> None:
    name = "\"><script>alert('x')</script>&amp;{{ 7 * 7 }}.h5"
    sensor = Sensor(name="<img src=x onerror=y>")
    text = render_page(make_source(make_layers(), source=name, sensor=sensor, options={"<b>": "<u>"}))
    page = check_page(text)
    assert name in page.text
    assert "<img src=x onerror=y>" in page.text
    assert page.all("b") == page.all("u") == []
    page = check_page(render_page(make_source(make_layers(), sensor=Sensor(name="bare"), options={})))
    assert "not known" in page.text


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "max_layers"), [((1, 1), 1), ((1, 20), 4), ((20, 1), 2)])
def test_page_of_images_of_any_shape_is_made(
    shape: tuple[int, int],
    max_layers: int,
    make_layers: MakeLayers,
    make_source: MakeSource,
    make_recording: MakeRecording,
) -> None:
    layers = make_layers(shape, max_layers=max_layers)
    page = check_page(render_page(make_source(layers), recording=make_recording((50, *shape))))
    assert len(page.all("img")) == 5 + min(3, max_layers)


@pytest.mark.slow
@pytest.mark.parametrize("status", [Status.NO_SURFACE, Status.TOO_FEW_SAMPLES])
def test_page_without_any_surface_is_made(status: Status, make_source: MakeSource) -> None:
    layers = Layers.empty((5, 6), 3)
    layers.status[...] = status
    page = check_page(render_page(make_source(layers)))
    assert "No pixel shows a surface." in page.text
    assert "0 % see more than one surface, 100 % see none." in page.text


def test_another_recording_is_refused(make_layers: MakeLayers, make_source: MakeSource) -> None:
    sensor = Sensor(name="x")
    with pytest.raises(UsageError, match="8 x 11 pixels, the layers have 9 x 11"):
        render_page(make_source(make_layers()), recording=ArrayRecording(np.ones((50, 8, 11)), sensor))
    with pytest.raises(UsageError, match="it has 49"):
        render_page(make_source(make_layers()), recording=ArrayRecording(np.ones((49, 9, 11)), sensor))


@pytest.mark.parametrize("module", ["matplotlib", "jinja2"])
def test_missing_extra_is_named(
    module: str, make_layers: MakeLayers, make_source: MakeSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError, match=r"the page needs matplotlib and jinja2: pip install 'tofmix\[report\]'"):
        render_page(make_source(make_layers()))


LAW = MixingLaw(phasor_share=0.97, pixels=1234)


def test_file_with_mixing_has_a_map_of_it(make_layers: MakeLayers, make_source: MakeSource) -> None:
    kinds = np.zeros((9, 11), np.uint8)
    kinds[2], kinds[3, :4], kinds[8, 8] = int(Mixing.PHASOR), int(Mixing.UNDECIDED), int(Mixing.EVENTS)
    source = make_source(replace(make_layers(), mixing=kinds))
    assert is_dataclass(source)
    text = render_page(replace(source, law=LAW))
    page = check_page(text)
    part = text.partition("<h2>Mixing</h2>")[2]
    assert "97 % of the samples at edges are phasor sums (1,234 pixels). A phasor sum is a sample" in page.text
    assert re.findall(r"<tr><td>([a-z ]+)</td><td>(\d+)</td><td>([\d.]+ %)</td></tr>", part) == [
        ("one surface", "83", "83.8 %"),
        ("events", "1", "1.0 %"),
        ("phasor", "11", "11.1 %"),
        ("undecided", "4", "4.0 %"),
    ]
    assert "one surface: 83 pixels; events: 1 pixel; phasor: 11 pixels; undecided: 4 pixels." in part
    pictures = re.findall(r'(?:src|srcset)="data:image/png;base64,([^"]+)"', part)[:2]
    assert len(set(pictures)) == 2  # dark and light
    for picture in pictures:
        with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
            shades = np.asarray(image.convert("RGB")).astype(int)
        assert shades.shape == (9, 11, 3)
        colours, place = np.unique(shades.reshape(-1, 3), axis=0, return_inverse=True)
        assert len(colours) == 4
        pairs = set(zip(place.ravel().tolist(), kinds.ravel().tolist(), strict=True))
        assert len(pairs) == 4  # each kind has a colour of its own


def test_headline_counts_pixels_windows_and_surfaces(make_layers: MakeLayers, make_source: MakeSource) -> None:
    summary = replace(
        summarise(make_source(make_layers())), rows=144, cols=176, share_several_surfaces=0.13, share_no_surface=0.0
    )
    expected = "25,344 pixels, 1 window of 50 frames: 13 % see more than one surface, 0 % see none."
    assert headline(summary) == expected
    unsure = replace(summary, undecided_by_surfaces=(0, 0, 12), pixels=100)
    assert headline(unsure).endswith(" 1 % see more than one surface, 0 % see none, 12 % are undecided.")
