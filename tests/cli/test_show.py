"""Commands that show: `info`, `inspect`, `report`, `verify`, `sensors` and `compare`."""

import json
import sys
from importlib.resources import files
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image
from support import naive_png
from support.bags import DEPTH, new_bag
from support.commandline import Estimated, Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode
from tofmix.sensors import PROFILES
from tofmix.simulation import BUILTIN_MODELS

FOV = {"fov_horizontal_deg": 40.0, "fov_vertical_deg": 30.0}


def codes(description: dict[str, list[dict[str, str]]]) -> set[str]:
    """Codes of the warnings."""
    return {warning["code"] for warning in description["warnings"]}


def test_info_prints_shape_and_units_of_a_recording(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(30), attributes=FOV)
    with h5py.File(path, "r+") as root:
        root["time"] = np.arange(30) / 25.0
        root.attrs["title"] = "two boards"
        root.attrs["gain"] = np.nan
    described = json.loads(tofmix("info", path, "--json").out)
    assert described["kind"] == "recording"
    assert described["sizes"] == {"frames": 30, "rows": 4, "cols": 6, "file_bytes": path.stat().st_size}
    assert described["range"]["units"] == "mm"
    assert described["range"]["type"] == "uint16"
    assert described["range"]["invalid_value"] == 0
    assert described["time"]["frame_rate_hz"] == pytest.approx(25)
    assert described["sensor"]["fov_horizontal_deg"] == 40.0
    assert described["sensor"]["noise_sigma_mm"] == [15.0, 15.0]
    assert described["attributes"]["title"] == "two boards"
    assert described["attributes"]["gain"] is None
    assert codes(described) == set()


def test_info_warns_of_missing_range_max_and_noise(tofmix: Tofmix, tmp_path: Path) -> None:
    path = tmp_path / "bare.h5"
    with h5py.File(path, "w") as root:
        root["range"] = boards(4).astype("f4")
        root["time"] = [0.0, 0.1, 0.2, 0.9]
    described = json.loads(tofmix("info", path, "--json").out)
    assert codes(described) == {"no_noise_curve", "no_range_max", "no_field_of_view", "time_gaps"}
    assert described["range"]["invalid_value"] is None
    with h5py.File(path, "r+") as root:
        root["time"][...] = [0.0, 0.3, 0.2, 0.9]
    assert "time_disordered" in codes(json.loads(tofmix("info", path, "--json").out))
    with h5py.File(path, "r+") as root:
        del root["time"]
        root["time"] = [0.0, 0.3]
    tofmix("info", path).refused(ExitCode.BAD_INPUT, "time")


def test_info_prints_sizes_options_and_source_of_layers(tofmix: Tofmix, tmp_path: Path) -> None:
    path = tmp_path / "a.layers.h5"
    arguments = ("--window", 20, "--min-samples", 21)
    tofmix.done("estimate", write_recording(tmp_path / "a.h5", boards(45)), *arguments)
    described = json.loads(tofmix("info", path, "--json").out)
    assert described["kind"] == "layers"
    assert described["sizes"]["windows"] == 2
    assert described["sizes"]["window_frames"] == 20
    assert described["sizes"]["frames_left_out"] == 5
    assert described["options"]["min_samples"] == 21
    assert described["made_from"]["source"] == "a.h5"
    assert codes(described) == {"too_few_samples", "no_surface_anywhere", "no_field_of_view"}


def test_info_prints_models_and_sensors(tofmix: Tofmix, tmp_path: Path) -> None:
    described = json.loads(tofmix("info", "corridor", "--json").out)
    assert described["kind"] == "model"
    assert described["recording"]["frames"] == 100
    assert len(described["scene"]["surfaces"]) == 8
    (tmp_path / "empty.toml").write_text('[sensor]\nprofile = "sr3000"\n')
    assert codes(json.loads(tofmix("info", tmp_path / "empty.toml", "--json").out)) >= {"no_surface"}
    sensor = json.loads(tofmix("info", str(files("tofmix.sensors") / "sr3000.toml"), "--json").out)
    assert sensor["kind"] == "sensor"
    assert sensor["sensor"]["rows"] == 144


def test_the_text_has_every_number_that_json_has(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(30))
    for name in (path, *BUILTIN_MODELS):
        described = json.loads(tofmix("info", name, "--json").out)
        text = tofmix("info", name).out
        for title, section in described.items():
            if isinstance(section, dict):
                assert f"\n{title.replace('_', ' ')}\n" in text
                assert all(f"\n  {key} " in text for key in section)
        for warning in described["warnings"]:
            assert f"warning: {warning['text']}" in text


def test_control_characters_of_names_do_not_reach_the_terminal(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    with h5py.File(layers, "r+") as root:
        root["range"].attrs["units"] = "\x1b[31m\nm"
    assert "\x1b" not in tofmix("verify", layers).out
    assert tofmix("verify", layers).out.count("\n") == 1
    path = write_recording(tmp_path / "a.h5", boards(30), attributes={"name": "\x1b[31mred\nx"})
    assert "\x1b" not in tofmix("info", path).out


def test_info_refuses_unknown_files_with_exit_code_3(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("no")
    (tmp_path / "bad.toml").write_text("[sensor")
    with h5py.File(tmp_path / "other.h5", "w") as root:
        root.attrs["format"] = "something-else"
    (tmp_path / "a.xyz").write_text("1 2 3")
    for name in ("none.h5", "text.h5", "bad.toml", "other.h5", "none.toml", "a.xyz", "."):
        outcome = tofmix("info", tmp_path / name)
        assert outcome.code == ExitCode.BAD_INPUT, name
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""


GAP = {
    "verdict": "explained",
    "effects": [{"kind": "wiggling", "parameters": {"amplitude_mm": 11.8}, "stderr": {}, "heldout_gain_nats": 1.0}],
    "where": [{"axis": "range", "interval": [2000.0, 2450.0], "statistic": "bias", "size": -10.9, "unit": "mm"}],
    "gap": {"before": 9.4, "after": 1.1, "floor": 1.0, "closed": 0.988},
    "next_steps": ["record a second surface"],
}


def write(folder: Path, kind: str) -> Path:
    """A source of 5 frames of 4 x 6 pixels."""
    samples = np.full((5, 4, 6), 1500, "u2")
    path = folder / f"source.{kind}"
    if kind == "npy":
        np.save(path, samples)
    elif kind == "csv":
        lines = ["frame,row,col,range_mm", "0,0,0,1500", *(f"{frame},3,5,1500" for frame in range(5))]
        path.write_text("\n".join(lines))
    elif kind == "h5":
        with h5py.File(path, "w") as root:
            root["entry/data"] = samples
    elif kind == "png":
        path = folder / "images"
        path.mkdir()
        for number, image in enumerate(samples):
            (path / f"{number}.png").write_bytes(naive_png.encode(image))
    else:
        with new_bag(folder, kind) as (bag, path):
            for number, image in enumerate(samples):
                bag.image(DEPTH, image, stamp_ns=10**9 + number)
    return path


@pytest.mark.parametrize("kind", ["npy", "csv", "h5", "png", "mcap"])
def test_a_source_is_described_with_the_command_that_imports_it(tofmix: Tofmix, tmp_path: Path, kind: str) -> None:
    path = write(tmp_path, kind)
    done = tofmix.done("info", path, "--json")
    described = json.loads(done.out)
    assert described["kind"] == "source"
    assert (described["sizes"]["frames"], described["sizes"]["rows"], described["sizes"]["cols"]) == (5, 4, 6)
    assert described["depths"]["along"] == ("z" if kind in ("png", "mcap") else "the beam")
    assert described["depths"]["unit_mm"] == (1.0 if kind in ("mcap", "csv") else None)
    assert f"tofmix import {path} -o" in described["warnings"][-1]["text"]
    assert "unit_mm" in tofmix("info", path).out


def test_gap_folder_is_summarised(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "gap.json").write_text(json.dumps(GAP))
    done = tofmix.done("info", tmp_path)
    for text in ("reconciliation", "explained", "wiggling", "11.8", "0.988", "record a second surface"):
        assert text in done.out
    assert json.loads(tofmix("info", tmp_path, "--json").out)["found"]["verdict"] == "explained"


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"verdict": 1}', "[" * 100_000, '{"verdict": "agree", "effects": []}']
)
def test_invalid_gap_folder_is_refused_in_one_line(tofmix: Tofmix, tmp_path: Path, text: str) -> None:
    (tmp_path / "gap.json").write_text(text)
    tofmix("info", tmp_path).refused(ExitCode.BAD_INPUT, "gap.json")


@pytest.fixture
def layers(estimated: Estimated) -> Path:
    return estimated(boards(60), window=30)


def test_inspect_prints_the_numbers_of_the_files(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    shown = tofmix.done(
        "inspect",
        layers,
        "--pixel",
        "2,3",
        "--window",
        1,
        "--neighbours",
        2,
        "--recording",
        tmp_path / "a.h5",
        "--json",
    )
    pixels = json.loads(shown.out)["pixels"]
    assert [(p["row"], p["col"]) for p in pixels] == [(2, 2), (2, 3), (2, 4)]
    with h5py.File(layers) as root:
        for pixel in pixels:
            place = 1, 2, pixel["col"]
            assert len(pixel["layers"]) == root["n_modes"][place]
            for k, layer in enumerate(pixel["layers"]):
                for name, field in (
                    ("range_mm", "range"),
                    ("range_stderr_mm", "range_stderr"),
                    ("weight", "weight"),
                    ("weight_stderr", "weight_stderr"),
                    ("probability", "probability"),
                ):
                    assert layer[name] == pytest.approx(float(root[field][(*place, k)]))
            assert pixel["samples_mm"] == boards(60)[30:, 2, pixel["col"]].tolist()
    text = tofmix("inspect", layers, "--pixel", "2,3", "--window", 1).out
    assert text.startswith("row 2, column 3: ")
    assert "row 2, column 5" in text
    assert "peaks of the density" not in text
    assert text.endswith("\nestimate kept layers of 0.999 or more (--false-alarm 0.001)\n")
    tofmix.done("estimate", tmp_path / "a.h5", "--refine", "none", "-o", tmp_path / "peaks.h5")
    assert "--false-alarm" not in tofmix("inspect", tmp_path / "peaks.h5", "--pixel", "2,3").out


@pytest.mark.parametrize("suffix", [pytest.param("png", marks=pytest.mark.slow), "svg"])
@pytest.mark.parametrize("over_frames", [False, True])
def test_inspect_writes_figures_as_png_and_svg(
    tofmix: Tofmix, layers: Path, tmp_path: Path, suffix: str, over_frames: bool
) -> None:
    figure = tmp_path / f"f.{suffix}"
    options = ["--over-frames"] if over_frames else []
    shown = tofmix.done("inspect", layers, "--pixel", "1,2", "--recording", tmp_path / "a.h5", "-o", figure, *options)
    assert shown.out.endswith(f"figure: {figure}\n")
    assert ("samples  peaks" in shown.out) == over_frames
    if suffix == "png":
        with Image.open(figure) as image:
            assert image.width > 800
            assert len(np.unique(np.asarray(image.convert("L")))) > 10
    else:
        assert "<svg" in figure.read_text()


def test_over_frames_counts_modes(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    arguments = ("inspect", layers, "--pixel", "0,0", "--recording", tmp_path / "a.h5", "--over-frames", "--json")
    grown = json.loads(tofmix(*arguments).out)["over_frames"]
    assert grown["n_samples"] == list(range(1, 31))
    assert grown["modes_mm"][-1] == pytest.approx([1200], abs=15)


def test_inspect_refuses_options_and_files_with_their_exit_code(
    tofmix: Tofmix, layers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = write_recording(tmp_path / "small.h5", boards(60, 2, 2))
    dark = boards(60)
    dark[:, 0, 0] = 0
    empty = write_recording(tmp_path / "dark.h5", dark)
    (tmp_path / "old.png").write_text("old")
    pixel = ("--pixel", "0,0")
    for arguments, code, text in (
        ((layers,), ExitCode.USAGE, "--pixel"),
        ((layers, "--pixel", "3"), ExitCode.USAGE, "is not ROW,COL"),
        ((layers, "--pixel", "a,b"), ExitCode.USAGE, "is not ROW,COL"),
        ((layers, "--pixel", "4,0"), ExitCode.USAGE, "rows 0 to 3 and columns 0 to 5"),
        ((layers, "--pixel", "0,-1"), ExitCode.USAGE, "columns 0 to 5"),
        ((layers, *pixel, "--window", 2), ExitCode.USAGE, "windows 0 to 1"),
        ((layers, *pixel, "--over-frames"), ExitCode.USAGE, "--recording"),
        ((layers, *pixel, "-o", tmp_path / "a.pdf"), ExitCode.USAGE, ".png, .svg"),
        ((layers, *pixel, "-o", tmp_path / "old.png"), ExitCode.USAGE, "--overwrite"),
        ((layers, *pixel, "--recording", other), ExitCode.BAD_INPUT, "does not match"),
        ((tmp_path / "a.h5", *pixel), ExitCode.BAD_INPUT, "not a layers file"),
    ):
        tofmix("inspect", *arguments).refused(code, text)
    another = tofmix("inspect", layers, *pixel, "--recording", empty)
    another.refused(ExitCode.BAD_INPUT, "dark.h5 is not the recording that")
    tofmix.done("estimate", empty)
    nothing = tofmix("inspect", tmp_path / "dark.layers.h5", *pixel, "--recording", empty, "--over-frames")
    assert nothing.code == ExitCode.BAD_INPUT
    assert nothing.err.endswith("row 0, column 0: the pixel has no valid sample\n")
    monkeypatch.setitem(sys.modules, "tofmix.report.pixels.pixel_figures", None)
    tofmix("inspect", layers, *pixel, "-o", tmp_path / "a.png").refused(ExitCode.USAGE, "pip install 'tofmix[report]'")
    assert not (tmp_path / "a.png").exists()
    assert (tmp_path / "old.png").read_text() == "old"


def test_the_table_counts_pixels(tofmix: Tofmix, layers: Path) -> None:
    shown = tofmix.done("report", layers)
    assert "ok" in shown.out
    assert shown.err == ""
    summary = json.loads(tofmix("report", layers, "--json").out)
    assert summary["pixels"] == 2 * 24
    assert sum(summary["pixels_by_surfaces"]) == 48


def test_html_page_is_written_with_the_table(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    page = tmp_path / "a.html"
    shown = tofmix.done("report", layers, "--recording", tmp_path / "a.h5", "--html", page, "--window", 1)
    assert shown.out.endswith(f"page: {page}\n")
    assert page.read_text().startswith("<!DOCTYPE html>")
    with_json = tofmix("report", layers, "--json", "--html", page, "--overwrite")
    json.loads(with_json.out)
    assert with_json.err == f"page: {page}\n"


def test_another_recording_is_refused(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    other = write_recording(tmp_path / "other.h5", boards(60) + np.uint16(1))
    shown = tofmix("report", layers, "--recording", other, "--html", tmp_path / "wrong.html")
    shown.refused(ExitCode.BAD_INPUT, "other.h5 is not the recording that")
    assert f"tofmix estimate {other}" in shown.err
    assert not (tmp_path / "wrong.html").exists()
    small = write_recording(tmp_path / "small.h5", boards(60, 2, 2))
    assert tofmix("report", layers, "--recording", small).code == ExitCode.BAD_INPUT


def test_report_refuses_options_and_files_with_their_exit_code(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    (tmp_path / "old.html").write_text("old")
    for arguments, code in (
        ((tmp_path / "none.h5",), ExitCode.BAD_INPUT),
        ((tmp_path / "a.h5",), ExitCode.BAD_INPUT),
        ((layers, "--recording", layers), ExitCode.BAD_INPUT),
        ((layers, "--html", tmp_path / "old.html"), ExitCode.USAGE),
        ((layers, "--html", layers, "--overwrite"), ExitCode.USAGE),
        ((layers, "--html", tmp_path / "b.html", "--window", 2), ExitCode.USAGE),
        ((layers, "--html", tmp_path / "none" / "b.html"), ExitCode.STORAGE),
    ):
        outcome = tofmix("report", *arguments)
        assert outcome.code == code, arguments
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""
    assert (tmp_path / "old.html").read_text() == "old"
    assert not (tmp_path / "b.html").exists()


def test_verify_of_valid_files_exits_with_0(tofmix: Tofmix, layers: Path) -> None:
    done = tofmix.done("verify", layers, layers.with_name("a.h5"))
    assert done.out == (
        f"{layers}: layers, 17 datasets read; no fault\n"
        f"{layers.with_name('a.h5')}: recording, 1 dataset read; no fault\n"
    )
    assert "range: without checksum" in done.err


def test_a_fault_has_its_line_and_its_exit_code(tofmix: Tofmix, layers: Path) -> None:
    with h5py.File(layers, "r+") as root:
        root["weight"][0, 1, 2, 0] = 0.5
        root["weight"][1, 1, 2, 0] = 0.5
    refused = tofmix("verify", layers)
    assert refused.code == ExitCode.BAD_INPUT
    rule = "sums to 1 with weight_no_return and weight_outlier"
    assert refused.out == f"{layers}: weight: broken: {rule} (window 0, row 1, col 2 and 1 more)\n"
    assert refused.err == ""
    described = json.loads(tofmix("verify", layers, layers.with_name("a.h5"), "--json").out)
    assert not described["ok"]
    assert [file["ok"] for file in described["files"]] == [False, True]
    assert described["files"][0]["faults"][0]["count"] == 2
    assert tofmix("verify", layers, layers.with_name("a.h5")).code == ExitCode.SOME_FAILED
    assert tofmix("verify", layers, layers.with_name("none.h5")).code == ExitCode.BAD_INPUT


MODEL = """
[sensor]
profile = "sr3000"
rows = 6
cols = 8
[recording]
frames = 12
[[surface]]
name = "board"
center_mm = [0.0, 0.0, 2000.0]
size_mm = [1500.0, 1500.0]
[[effect]]
kind = "fixed_pattern"
pixel_sigma_mm = 3.0
column_sigma_mm = 1.0
row_sigma_mm = 1.0
[[effect]]
kind = "interference"
probability = 0.2
sigma_mm = 50.0
[[effect]]
kind = "motion"
surface = "board"
velocity_mm_s = 100.0
"""


def test_every_dataset_that_is_written_has_checksums(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    tofmix.done("simulate", tmp_path / "model.toml", "-o", tmp_path / "a.h5")
    tofmix.done("estimate", tmp_path / "a.h5", "--window", 6)
    for name, expected in (("a.h5", "truth/range_true_frames"), ("a.layers.h5", "sensor/noise_sigma")):
        datasets: dict[str, bool] = {}

        def see(path: str, item: h5py.Group | h5py.Dataset, found: dict[str, bool] = datasets) -> None:
            if isinstance(item, h5py.Dataset):
                found[path] = bool(item.fletcher32)

        with h5py.File(tmp_path / name) as root:
            root.visititems(see)
        assert expected in datasets
        assert [path for path, guarded in datasets.items() if not guarded] == []
        tofmix.done("verify", tmp_path / name)


def test_list_names_every_profile_and_marks_unknown_values(tofmix: Tofmix) -> None:
    done = tofmix.done("sensors")
    lines = {line.split()[0]: line for line in done.out.splitlines()[1:]}
    assert list(lines) == list(PROFILES)
    assert "45 x 45" in lines["vl53l5cx"]
    assert "0.02 to 4 m" in lines["vl53l5cx"]
    assert lines["tmf8828"].split()[5] == "-"
    assert " yes " in lines["sr3000"]
    assert [lines[name].split()[1] for name in ("pico-flexx", "l515", "stoc")] == ["lock-in", "pulses", "stereo"]


def test_json_is_one_object_a_line(tofmix: Tofmix) -> None:
    objects = [json.loads(line) for line in tofmix("sensors", "--json").out.splitlines()]
    assert [one["profile"] for one in objects] == list(PROFILES)
    by_name = {one["profile"]: one for one in objects}
    assert by_name["vl53l8cx"]["fov_horizontal_deg"] is None
    assert by_name["l515"]["noise_sigma_mm"] is None
    assert by_name["azure-kinect-wfov"]["measurement"] == "lock-in"
    assert by_name["sr3000"]["noise_sigma_mm"][0] == 2.5
    assert json.loads(tofmix("sensors", "l515", "--json").out) == by_name["l515"]


def test_printed_camera_file_is_accepted_by_import(tofmix: Tofmix, tmp_path: Path) -> None:
    text = tofmix("sensors", "vl53l5cx", "--toml").out
    (tmp_path / "mine.toml").write_text(text.replace('"VL53L5CX"', '"mine"'))
    np.save(tmp_path / "a.npy", np.full((3, 8, 8), 1000, "u2"))
    tofmix.done("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--sensor", tmp_path / "mine.toml")
    with h5py.File(tmp_path / "a.h5") as root:
        assert root["sensor"].attrs["name"] == "mine"
        assert root["sensor"].attrs["fov_horizontal_deg"] == 45.0
        assert np.isnan(root["sensor"].attrs["integration_time_ms"])


def test_unknown_sensors_are_refused_with_their_exit_code(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((3, 8, 8), 1000, "u2"))
    tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    for arguments, code, text in (
        (("sensors", "sr300"), ExitCode.USAGE, 'did you mean "sr3000"'),
        (("sensors", "--toml"), ExitCode.USAGE, "give its NAME"),
        (("sensors", "l515", "--toml", "--json"), ExitCode.USAGE, "exclude each other"),
        (("estimate", tmp_path / "a.h5", "--noise", "l515"), ExitCode.USAGE, "the noise of L515 is not known"),
    ):
        tofmix(*arguments).refused(code, text)


@pytest.fixture
def moved(layers: Path) -> Path:
    """The same with one range of the second window moved by 5 combined standard errors, and one count less."""
    path = layers.with_name("b.layers.h5")
    path.write_bytes(layers.read_bytes())
    with h5py.File(path, "r+") as root:
        error = root["range_stderr"][1, 0, 0, 0]
        root["range"][1, 0, 0, 0] += 5 * 2**0.5 * error
        root["n_modes"][0, 3, 2] = root["n_modes"][0, 3, 2] - 1
    return path


def test_files_are_equal_within_a_tolerance_and_an_allowed_share(tofmix: Tofmix, layers: Path, moved: Path) -> None:
    shown = tofmix.done("compare", layers, layers, "--tolerance", 0)
    assert shown.out.endswith("\nequal\n")
    assert shown.err == ""
    found = json.loads(tofmix("compare", layers, moved, "--tolerance", 5.1, "--json").out)
    assert (found["count_differs"], found["range_differs"]) == (1, 0)
    tofmix.done("compare", layers, moved, "--allow", 2 / 48)
    assert tofmix("compare", layers, moved, "--allow", 1.9 / 48).code == ExitCode.DIFFERENT


def test_differences_exit_with_6_and_list_their_pixels(tofmix: Tofmix, layers: Path, moved: Path) -> None:
    shown = tofmix("compare", layers, moved, "--json")
    assert shown.code == int(ExitCode.DIFFERENT) == 6
    found = json.loads(shown.out)
    assert not found["equal"]
    assert (found["different"], found["count_differs"], found["range_differs"]) == (2, 1, 1)
    assert found["different_by_window"] == [1, 1]
    assert found["gap_largest_errors"] == pytest.approx(5, rel=1e-4)
    places = [(p["window"], p["row"], p["col"]) for p in found["pixels_shown"]]
    assert places == [(0, 3, 2), (1, 0, 0)]
    assert tofmix("compare", layers, moved).out.endswith("\ndifferent\n")


@pytest.mark.slow
def test_html_page_is_written_with_the_same_exit_code(
    tofmix: Tofmix, layers: Path, moved: Path, tmp_path: Path
) -> None:
    page = tmp_path / "c.html"
    shown = tofmix("compare", layers, moved, "--html", page, "--window", 1)
    assert shown.code == ExitCode.DIFFERENT
    assert shown.out.endswith(f"page: {page}\n")
    assert "a.layers.h5 against b.layers.h5" in page.read_text()
    with_json = tofmix("compare", layers, moved, "--json", "--html", page, "--overwrite")
    json.loads(with_json.out)
    assert with_json.err == f"page: {page}\n"


def test_compare_refuses_options_and_files_with_their_exit_code(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    tofmix.done("estimate", tmp_path / "a.h5", "-o", tmp_path / "one.layers.h5")
    (tmp_path / "old.html").write_text("old")
    for arguments, code, text in (
        ((layers, tmp_path / "one.layers.h5"), ExitCode.BAD_INPUT, "different sizes"),
        ((layers, tmp_path / "none.h5"), ExitCode.BAD_INPUT, "No such file"),
        ((tmp_path / "a.h5", layers), ExitCode.BAD_INPUT, "not a layers file"),
        ((layers,), ExitCode.USAGE, "'B'"),
        ((layers, layers, "--tolerance", -1), ExitCode.USAGE, "--tolerance"),
        ((layers, layers, "--window", 0), ExitCode.USAGE, "--html"),
        ((layers, layers, "--html", tmp_path / "b.html", "--window", 2), ExitCode.USAGE, "windows 0 to 1"),
        ((layers, layers, "--html", tmp_path / "old.html"), ExitCode.USAGE, "--overwrite"),
        ((layers, layers, "--html", layers, "--overwrite"), ExitCode.USAGE, "is the input"),
    ):
        tofmix("compare", *arguments).refused(code, text)
    assert (tmp_path / "old.html").read_text() == "old"
