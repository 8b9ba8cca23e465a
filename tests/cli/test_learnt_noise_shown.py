"""Learnt noise as `report`, `inspect` and `info` show it, from files."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording
from support.learnt_noises import ALL, SIGMA_MM, Made, made, write_files

FRAMES, IMAGE = 80, (4, 6)
LINE = re.compile(
    r"sigma 20 mm, skewed \(1\.0\), background 15 to 15 % by pixel, widths differ by 20 %,"
    r" pixels drift by 80 mm in a window, memory 0\.1"
)


@pytest.fixture(scope="module")
def case() -> Made:
    return made(ALL, frames=FRAMES, image=IMAGE)


@pytest.fixture(scope="module")
def paths(case: Made, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_files(tmp_path_factory.mktemp("learnt"), case)


@pytest.mark.slow
def test_report_shows_learnt_noise_with_and_without_the_recording(
    tofmix: Tofmix, paths: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, layers = paths
    pages = []
    for name, options in (("with", ("--recording", recording)), ("without", ())):
        pages.append(tmp_path / f"{name}.html")
        said = tofmix("report", layers, *options, "--html", pages[-1])
        assert said.code == 0, said.err
        assert LINE.search(re.sub(r"\s+", " ", said.out))
    for page in pages:
        titles = re.findall(r"<h3>([^<]*)</h3>", page.read_text().partition("<h2>Noise</h2>")[2])
        assert titles == ["Sigma of single pixels", "Shape of the error", "Widths of the pixels", "Background"]
    assert "With --recording the points" in pages[1].read_text()


def test_json_of_report_has_the_parts_and_with_the_recording_its_scatter(
    tofmix: Tofmix, paths: tuple[Path, Path]
) -> None:
    recording, layers = paths
    alone = json.loads(tofmix("report", layers, "--json").out)["noise"]
    both = json.loads(tofmix("report", layers, "--recording", recording, "--json").out)["noise"]
    assert LINE.fullmatch(alone["line"])
    assert (alone["width_spread"], alone["memory"], alone["drift_mm"]) == (0.2, 0.1, [40.0, 10.0, 5.0])
    assert alone["widths"]["count"] == 24
    assert alone["scatter_over_sigma"] is None
    scatter = both.pop("scatter_over_sigma")
    assert both == {key: value for key, value in alone.items() if key != "scatter_over_sigma"}
    assert scatter["count"] >= 20
    assert scatter["q50"] == pytest.approx(1.0, abs=0.15)


def test_info_prints_learnt_noise_in_a_line_and_by_part(tofmix: Tofmix, paths: tuple[Path, Path]) -> None:
    text = tofmix("info", paths[1]).out
    found = re.search(r"^noise\n((?:  .*\n?)+)", text, re.MULTILINE)
    assert found is not None
    assert LINE.search(found[1])
    assert [line.split()[0] for line in found[1].splitlines()] == [
        "found",
        "shape",
        "skewness",
        "excess_kurtosis",
        "width_spread",
        "drift_mm",
        "memory",
        "background_q05",
        "background_q50",
        "background_q95",
    ]
    noise = json.loads(tofmix("info", paths[1], "--json").out)["noise"]
    assert LINE.fullmatch(noise["found"])
    assert noise["shape"] == "skewed (1.0)"
    assert (noise["width_spread"], noise["drift_mm"], noise["memory"]) == (0.2, [40.0, 10.0, 5.0], 0.1)
    assert noise["background_q50"] == pytest.approx(0.15)


@pytest.mark.slow
def test_inspect_prints_and_draws_the_mixture(
    tofmix: Tofmix, case: Made, paths: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, layers = paths
    figure = tmp_path / "pixel.svg"
    time = np.linspace(-1, 1, FRAMES)
    polynomials = np.array([time, 1.5 * time**2 - 0.5, 2.5 * time**3 - 1.5 * time])
    extent = np.ptp(np.einsum("drc,dt->rct", case.drift_mm, polynomials), axis=-1)
    row, col = divmod(int(extent.argmax()), IMAGE[1])
    arguments = ("inspect", layers, "--pixel", f"{row},{col}", "--recording", recording)
    said = tofmix(*arguments, "-o", figure)
    assert said.code == 0, said.err
    own_noise = r"^  noise of the pixel: width \d\.\d\d, background \d+\.\d %, drift \(mm\): \d+\.\d$"
    assert re.search(own_noise, said.out, re.MULTILINE)
    assert "<svg" in figure.read_text()
    pixel = next(p for p in json.loads(tofmix(*arguments, "--json").out)["pixels"] if p["col"] == col)
    own = pixel["learnt_noise"]
    assert own["width"] == pytest.approx(case.width[row, col], rel=0.35)
    assert pixel["layers"][0]["sigma_mm"] == pytest.approx(SIGMA_MM * own["width"], rel=1e-5)
    assert own["background"] == pixel["weight_outlier"]
    assert own["drift_mm"][0] == pytest.approx(extent[row, col], rel=0.2)
    without = tofmix("inspect", layers, "--pixel", "0,0", "--json", "-o", tmp_path / "layers.png")
    assert without.code == 0, without.err
    assert json.loads(without.out)["pixels"][0]["learnt_noise"]["drift_mm"] is None


def test_report_omits_learnt_noise_of_a_gaussian_curve(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", boards(30))
    layers = tmp_path / "a.layers.h5"
    assert tofmix("estimate", recording, "--noise", "file").code == 0
    assert "noise" not in json.loads(tofmix("info", layers, "--json").out)
    assert "\nnoise\n" not in tofmix("info", layers).out
    assert json.loads(tofmix("report", layers, "--json").out)["noise"] is None
    said = tofmix("inspect", layers, "--pixel", "1,1", "--recording", recording)
    assert "noise of the pixel" not in said.out
    pixels = json.loads(tofmix("inspect", layers, "--pixel", "1,1", "--json").out)["pixels"]
    assert all("learnt_noise" not in pixel for pixel in pixels)
