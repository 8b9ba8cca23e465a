import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.alike import MakeLayers, MakeRecording, MakeSource
from support.chromium import Tab, chromium, tab
from support.learnt_noises import ALL, camera

from tofmix.estimation.peaks.modes import density
from tofmix.layers import Layers
from tofmix.report.page import render_page
from tofmix.report.pixels.pixels import format_pixels, view_pixels
from tofmix.report.templates import read_part
from tofmix.sensor import NoiseCurve

BROWSER = chromium()
pytestmark = [pytest.mark.browser, pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")]

READY = "document.documentElement?.dataset.explorer === 'ready'"
ROWS, COLS = 9, 11


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    assert BROWSER is not None
    with tab(BROWSER, tmp_path_factory.mktemp("profile")) as opened:
        opened.look(width=1280, height=900)
        yield opened


@pytest.fixture
def windows(make_layers: MakeLayers) -> list[Layers]:
    made = [make_layers(seed=seed) for seed in range(2)]
    for layers in made:
        layers.weight_stderr[...] = layers.weight / 7
        layers.probability[...] = np.where(np.isfinite(layers.weight), 0.987654, np.nan)
    return made


@pytest.fixture
def page(windows: list[Layers], make_source: MakeSource, make_recording: MakeRecording, tmp_path: Path) -> Path:
    path = tmp_path / "page.html"
    path.write_text(render_page(make_source(*windows), recording=make_recording((100, ROWS, COLS))), encoding="utf-8")
    return path


def check_pixel(browser: Tab, layers: Layers, row: int, col: int) -> None:
    """Compare what stands in the page with what `tofmix inspect` prints of the pixel."""
    assert browser.text("#x-pixel-title") == f"Row {row}, column {col}"
    assert browser.text("#x-said").startswith(f"Row {row}, column {col}: ")
    (view,) = view_pixels(layers, row=row, cols=[col], samples=None, noise=None)
    lines = format_pixels([view], col).splitlines()
    cells = browser.value(
        "[...document.querySelectorAll('#x-layers tbody tr')].map(r => [...r.cells].map(c => c.textContent))"
    )
    printed = [line.split() for line in lines[2:-1]]
    assert len(cells) == len(view.range_mm)
    for (layer, distance, share, sigma, probability), words in zip(cells, printed, strict=True):
        assert [layer, *distance.split(" ± "), *share.split(" ± "), sigma, probability] == words
    facts = browser.text("#x-facts")
    assert f"Status{view.status.replace('_', ' ')}: " in facts
    assert f"peaks of the density{view.n_samples}; {view.n_peaks}" in facts
    no_return = f"{view.weight_no_return:.4f}" if np.isfinite(view.weight_no_return) else "\u2013"
    assert f"without a return{no_return}" in facts


def test_a_click_shows_the_right_numbers(browser: Tab, page: Path, windows: list[Layers]) -> None:
    browser.said.clear()
    browser.open(page, ready=READY)
    for row, col in ((0, 0), (8, 10), (3, 7), (5, 2)):
        browser.click("#x-plane", (col + 0.5) / COLS, (row + 0.5) / ROWS)
        check_pixel(browser, windows[0], row, col)
        for kind in (1, 2, 3):  # one mean line a layer
            assert browser.value(
                f"document.querySelectorAll('#x-mixture line[stroke=\"var(--layer-{kind})\"]').length"
            ) == sum(k % 3 == kind - 1 for k in range(int(windows[0].n_modes[row, col])))
    assert browser.said == []


def test_every_pixel_can_be_reached_by_keys(browser: Tab, page: Path, windows: list[Layers]) -> None:
    browser.said.clear()
    browser.open(page, link="#pixel=4,4", ready=READY)
    check_pixel(browser, windows[0], 4, 4)
    browser.value("document.querySelector('#x-plane').focus()")
    row, col = 4, 4
    for key, down, right in (("ArrowUp", -1, 0), ("ArrowRight", 0, 1), ("ArrowDown", 1, 0), ("ArrowLeft", 0, -1)) * 2:
        browser.press(key)
        row, col = row + down, col + right
        check_pixel(browser, windows[0], row, col)
    for key, place in (("Home", (4, 0)), ("ArrowLeft", (4, 0)), ("End", (4, 10))):
        browser.press(key)
        check_pixel(browser, windows[0], *place)
    browser.press("ArrowUp", shift=True)
    check_pixel(browser, windows[0], 0, 10)
    browser.choose("#x-row", 6)
    browser.choose("#x-col", 1)
    check_pixel(browser, windows[0], 6, 1)
    browser.choose("#x-row", 99)
    check_pixel(browser, windows[0], 8, 1)
    assert browser.value("location.hash") == "#pixel=8,1&window=0&image=layer-0&section=row&drawn=plain"
    assert browser.said == []


def test_the_image_is_that_of_the_chosen_layer_and_window(browser: Tab, page: Path, windows: list[Layers]) -> None:
    browser.said.clear()
    browser.open(page, link="#pixel=2,3&window=1&image=layer-1&section=column", ready=READY)
    check_pixel(browser, windows[1], 2, 3)
    visible = (
        f"(() => {{const copy = new OffscreenCanvas({COLS}, {ROWS}).getContext('2d', {{willReadFrequently: true}});"
        "copy.drawImage(document.querySelector('#x-canvas'), 0, 0);"
        f"return [...copy.getImageData(0, 0, {COLS}, {ROWS}).data]"
        ".filter((_, k) => k % 4 === 3).map((a) => a > 0);})()"
    )
    assert browser.value(visible) == (windows[1].n_modes.ravel() > 1).tolist()
    assert browser.text("#x-image-title") == "Second layer"
    assert browser.text("#x-section-title") == "Section through column 3"
    browser.choose("#x-window", 0)
    browser.wait("document.querySelector('#x-window').value === '0' && location.hash.includes('window=0')")
    check_pixel(browser, windows[0], 2, 3)
    assert browser.value(visible) == (windows[0].n_modes.ravel() > 1).tolist()
    browser.choose("#x-view", "surfaces")
    assert browser.value(visible) == (windows[0].status.ravel() != 1).tolist()
    browser.choose("#x-view", "layer-0")
    browser.choose("#x-high", 3000)
    assert "above 3000 mm" in browser.text("#x-legend")
    browser.click("#x-reset")
    assert float(browser.value("document.querySelector('#x-high').value")) > 3000
    assert browser.said == []


def test_a_section_and_the_neighbours_can_be_clicked(browser: Tab, page: Path, windows: list[Layers]) -> None:
    browser.said.clear()
    browser.open(page, link="#pixel=4,5", ready=READY)
    several = int((windows[0].n_modes[4] > 1).sum())
    assert browser.text("#x-section-alt").startswith(f"{several} of 11 pixels see more than one surface")
    browser.click("#x-neighbours tr:nth-child(1) td:nth-child(3) button")
    check_pixel(browser, windows[0], 3, 6)
    left, width = 56, browser.value("document.querySelector('#x-section').viewBox.baseVal.width")
    browser.click("#x-section", (left + (width - 10 - left) * 2.5 / COLS) / width, 0.5)
    check_pixel(browser, windows[0], 3, 2)
    browser.choose("#x-along", "column")
    assert browser.text("#x-section-title") == "Section through column 2"
    crosses_last = (
        "(() => {const paths = [...document.querySelectorAll('#x-section path')];"
        " return paths.findIndex((path) => path.classList.contains('averaged'))"
        " > paths.findLastIndex((path) => path.hasAttribute('fill-opacity'));})()"
    )
    assert browser.value(crosses_last), "averaged crosses are drawn over the layers' marks"
    assert browser.said == []


def test_samples_and_density_are_those_of_the_estimator(
    browser: Tab, page: Path, make_recording: MakeRecording
) -> None:
    browser.open(page, ready=READY)
    curve = NoiseCurve(np.array([500.0, 3000.0, 7500.0]), np.array([9.0, 70.0, 430.0]))
    noise = [curve.range_mm.tolist(), curve.sigma_mm.tolist()]
    places = np.linspace(2200, 3900, 60)
    answer = browser.call(
        "Runtime.evaluate",
        returnByValue=True,
        awaitPromise=True,
        expression=f"(async () => {{{read_part('explorer_data.js')}\n"
        "const settings = JSON.parse(document.getElementById('explorer-data').textContent);"
        f"const samples = (await WindowData.read(settings.windows[1], {ROWS * COLS})).samples(40);"
        f"return [[...samples], densityAt(samples, {json.dumps(places.tolist())}, {json.dumps(noise)})];}})()",
    )
    samples, p = answer["result"]["value"]
    expected = make_recording((100, ROWS, COLS)).read_range(slice(50, 100), slice(0, ROWS)).reshape(50, -1)[:, 40]
    expected = np.sort(expected[np.isfinite(expected)]).astype(np.float64)
    np.testing.assert_allclose(samples, expected, rtol=0, atol=0.051)
    np.testing.assert_allclose(p, density(np.array(samples), places, curve), rtol=1e-9, atol=1e-15)


def test_components_of_learnt_noise_are_drawn_with_its_shape(
    browser: Tab, make_source: MakeSource, make_recording: MakeRecording, tmp_path: Path
) -> None:
    layers = Layers.empty((ROWS, COLS), 2)
    layers.n_modes[...], layers.n_samples[...] = 1, 50
    layers.range[..., 0], layers.sigma[..., 0], layers.weight[..., 0] = 2000.0, 20.0, 0.8
    layers.weight_no_return[...], layers.weight_outlier[...] = 0.0, 0.2
    source = make_source(layers, sensor=camera(ALL, (ROWS, COLS)))
    path = tmp_path / "learnt.html"
    path.write_text(render_page(source, recording=make_recording((50, ROWS, COLS))), encoding="utf-8")
    browser.said.clear()
    browser.open(path, link="#pixel=2,3", ready=READY)
    drawn = browser.value("document.querySelector('#x-mixture path[fill=\"var(--layer-1)\"]').getAttribute('d')")
    x, y = np.array([pair.split() for pair in drawn.strip("MZ").split("L")[1:-1]], dtype=float).T
    height = y.max() - y
    assert ALL.shape is not None
    top = x[height.argmax()]
    left, right = height[x < top].sum(), height[x > top].sum()
    peak = ALL.shape.z[ALL.shape.density.argmax()]
    assert left / (left + right) == pytest.approx(float(ALL.shape.cdf(peak)), abs=0.05)
    assert browser.said == []
