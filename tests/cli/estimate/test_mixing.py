"""`tofmix estimate` on lock-in cameras: `--mixing`, `--wrap`, and what is said of recordings that lack something."""

import json
import re
import shlex
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import contents, write_recording
from support.lock_in import small, write_sums

import tofmix as tm
from tofmix.circle import fold, unambiguous_range_mm
from tofmix.errors import DoubtWarning, ExitCode
from tofmix.flags import Mixing


@pytest.fixture(scope="module")
def sums(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two windows of phasor sums, with a few pixels that stay undecided."""
    return write_sums(tmp_path_factory.mktemp("sums") / "a.h5", small(4).recording)


WINDOWS = ("--window", 20, "--noise", "file")


@pytest.mark.slow
def test_bytes_do_not_depend_on_pieces_where_mixing_is_measured(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    tofmix.same_in_pieces(Path(shutil.copy(sums, tmp_path)), *WINDOWS)
    merged = tofmix("merge", tmp_path / "1.part", tmp_path / "2.part", "-o", tmp_path / "again.h5")
    assert "mixing: 100 % of the samples at edges are phasor sums" in merged.err


def test_mixing_law_is_printed_and_stored(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    done = tofmix("estimate", sums, *WINDOWS, "-o", out, "--json")
    said = json.loads(done.out)
    assert said["mixing"]["phasor_share"] == pytest.approx(1.0, abs=0.03)
    with h5py.File(out) as root:
        assert root["phasor_pixels"][...].sum() == said["mixing"]["pixels"] > 100
        mixing = root["mixing"]
        assert mixing.attrs["flag_meanings"] == "one_surface events phasor undecided"
        mixed = mixing[...] == int(Mixing.PHASOR)
        assert mixed.sum() > 200
        assert (root["n_modes"][...][mixed] >= 1).all()
        assert sum(said["pixels_by_surfaces"][2:]) == (root["n_modes"][...] > 1).sum()
        unsure = root["n_modes"][...][mixing[...] == int(Mixing.UNDECIDED)]
    assert said["undecided_by_surfaces"] == np.bincount(unsure, minlength=7).tolist()
    assert unsure.size > 0
    line = tofmix("estimate", sums, *WINDOWS, "-o", out, "--resume").out
    assert line.endswith(f"; {unsure.size} undecided, not counted\n")
    counted = [int(count.replace(",", "")) for count in re.findall(r" \d: (\d[\d,]*\d|\d)", line)]
    assert sum(counted) + unsure.size == sum(said["pixels_by_surfaces"])
    assert f"undecided       {unsure.size:>10}" in tofmix("report", out).out
    tofmix.done("verify", out)
    assert "phasor sums" in tofmix("info", out).out


def test_recordings_without_amplitudes_have_one_warning_and_no_mixing(tofmix: Tofmix, tmp_path: Path) -> None:
    plain = write_sums(tmp_path / "a.h5", small(1).recording, amplitude=False)
    done = tofmix("estimate", plain, "--noise", "file")
    assert [line for line in done.err.splitlines() if "flying pixels" in line]
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert "mixing" not in root
    refused = tofmix("estimate", plain, "--mixing", "phasor", "--overwrite")
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err == (
        f"tofmix: {plain}: no amplitudes, which --mixing phasor needs; import the recording with --amplitude\n"
    )
    assert tofmix("estimate", plain, "--paper", "--mixing", "phasor", "--overwrite").code == ExitCode.USAGE


def test_export_omits_undecided_pixels_without_the_option(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    tofmix.done("estimate", sums, *WINDOWS, "-o", out)
    with h5py.File(out) as root:
        undecided = root["mixing"][...] == int(Mixing.UNDECIDED)
        extra = int(np.isfinite(root["range"][...])[undecided].sum())
    assert extra > 0
    without, with_them = (
        json.loads(tofmix("export", out, "-o", tmp_path / f"{k}.ply", *option, "--json").out)["points"]
        for k, option in enumerate(((), ("--undecided",)))
    )
    assert with_them - without == extra


@pytest.mark.slow
def test_inspect_prints_and_draws_the_kind_of_mixing(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    out, events = tmp_path / "a.h5", tmp_path / "events.h5"
    tofmix.done("estimate", sums, *WINDOWS, "-o", out)
    tofmix.done("estimate", sums, *WINDOWS, "-o", events, "--mixing", "events")
    with h5py.File(out) as root:
        row, col = np.argwhere(root["mixing"][1] == int(Mixing.PHASOR))[0].tolist()
    place = ("--pixel", f"{row},{col}", "--window", 1, "--neighbours", 0)
    assert "\n  mixing: phasor\n" in tofmix("inspect", out, *place).out
    assert json.loads(tofmix("inspect", out, *place, "--json").out)["pixels"][0]["mixing"] == "phasor"
    assert "mixing" not in tofmix("inspect", events, *place).out
    assert "mixing" not in json.loads(tofmix("inspect", events, *place, "--json").out)["pixels"][0]
    heights = []
    for number, (layers, options) in enumerate(
        ((out, ("--recording", sums)), (out, ()), (events, ("--recording", sums)))
    ):
        figure = tmp_path / f"{number}.svg"
        tofmix.done("inspect", layers, *place, *options, "-o", figure)
        heights.append(float(figure.read_text().partition('height="')[2].partition("pt")[0]))
    assert heights[0] > heights[1] + 200
    assert heights[1] == heights[2]


LENGTH = unambiguous_range_mm(20e6)
SENSOR = {"range_min_mm": 300.0, "range_max_mm": 6500.0, "modulation_frequency_hz": 20e6}


def _folded(path: Path, dtype: str = "f4", **attributes: float) -> Path:
    """Left half a wall at the fold, right half a board."""
    rng = np.random.default_rng(3)
    range_mm = np.where(np.arange(12) < 6, LENGTH + 5.0, 2000.0) + rng.normal(0, 60, (60, 8, 12))
    noise = {"noise_range": [500.0, 8000.0], "noise_sigma": [60.0, 60.0]}
    return write_recording(
        path, fold(np.rint(range_mm), LENGTH).astype(dtype), attributes=SENSOR | attributes, noise=noise, fill=65535
    )


@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "option"), [("f4", ["--wrap"]), ("u2", ["--unambiguous-range", LENGTH])])
def test_a_wall_at_the_fold_is_one_surface(tofmix: Tofmix, tmp_path: Path, dtype: str, option: list[object]) -> None:
    recording, layers = _folded(tmp_path / "a.h5", dtype), tmp_path / "a.layers.h5"
    outcome = tofmix("estimate", recording, *option, "--mixing", "events")
    said = [line for line in outcome.err.splitlines() if "compiling the kernels" not in line]
    assert (outcome.code, said) == (0, [])
    found = contents(layers)
    assert (found["n_modes"] == 1).all()
    wall = fold(found["range"][0, :, :6, 0] + LENGTH / 2, LENGTH) - LENGTH / 2
    np.testing.assert_allclose(wall, 5, atol=35)
    assert json.loads(found["options"])["unambiguous_range_mm"] == pytest.approx(LENGTH)
    assert (found["n_samples"] == 60).all()  # with another _FillValue, an integer 0 is a range
    tofmix.done("estimate", recording, "--noise", "file", "-o", tmp_path / "line.h5")
    line = contents(tmp_path / "line.h5")
    assert (line["n_modes"][0, :, :6] == 1).mean() < 0.9 or not (line["range"][0, :, :6, 0] > 6000).all()


@pytest.mark.slow
def test_noise_and_outliers_are_measured_on_the_circle(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = _folded(tmp_path / "a.h5")
    automatic = "--noise", "auto", "--outliers", "auto"
    outcome = tofmix.done("estimate", recording, "--wrap", *automatic, "--mixing", "events")
    (line,) = outcome.err.splitlines()  # no warning that curve and recording disagree
    assert "noise: sigma 5" in line or "noise: sigma 6" in line
    found = tmp_path / "a.layers.h5"
    assert (contents(found)["n_modes"] == 1).all()
    with h5py.File(found) as root:
        sensor = root["sensor"]
        at = np.interp([2000.0, LENGTH], sensor["noise_range"][...], sensor["noise_sigma"][...])
        np.testing.assert_allclose(at, 60, rtol=0.06)
        assert sensor.attrs["outlier_probability"] < 0.001


def test_a_recording_without_frequency_is_refused(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", np.full((10, 2, 2), 1000.0))
    tofmix("estimate", recording, "--wrap").refused(ExitCode.BAD_INPUT, "no modulation_frequency_hz")
    assert not (tmp_path / "a.layers.h5").exists()


def test_range_max_at_the_fold_leaves_out_c0_with_a_note(tofmix: Tofmix, tmp_path: Path) -> None:
    outcome = tofmix.done("estimate", _folded(tmp_path / "a.h5", range_max_mm=7490.0), "--wrap", "--mixing", "events")
    assert "c_0 is left out" in outcome.err
    assert outcome.err.count("\n") == 1
    found = contents(tmp_path / "a.layers.h5")
    assert (found["weight_no_return"] == 0).all()
    assert (found["n_modes"] == 1).all()


FRAMES = 30
VIEW = ("--fov", "16x13", "--units", "mm")
QUICK = ("--noise", "sr3000")
"""Any curve: to learn the noise takes a second, and says nothing about phases."""
CODE = "flying_pixels_counted"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ranges and amplitudes at 20 MHz, each an array; two boards before a wall, all light added up.

    `part.npy` has fewer pixels, for what is said whatever they show.
    """
    folder = tmp_path_factory.mktemp("sums")
    seen = small(11).recording
    np.save(folder / "ranges.npy", seen.read_range(slice(0, FRAMES), slice(None)))
    np.save(folder / "amplitudes.npy", seen.read_amplitude(slice(0, FRAMES), slice(None)))
    np.save(folder / "part.npy", seen.read_range(slice(0, FRAMES), slice(0, 24))[:, :, 20:40])
    return folder


def test_the_remedy_of_the_warning_finds_the_surfaces_of_flying_pixels(
    tofmix: Tofmix, folder: Path, tmp_path: Path
) -> None:
    path, layers = tmp_path / "a.h5", tmp_path / "a.layers.h5"
    made = tofmix("import", folder / "ranges.npy", "-o", path, "--sensor", "kinect-v2", *VIEW)
    assert "amplitudes (flying pixels are counted as surfaces without: import --amplitude AMPLITUDES)" in made.out
    assert "modulation frequency (flying pixels are counted as surfaces without: import --modulation-frequ" in made.out
    done = tofmix("estimate", path, *QUICK, "--json")
    (warned,) = [one for one in json.loads(done.out)["warnings"] if one["code"] == CODE]
    assert done.err.count("flying pixels") == 1
    assert f"{layers}: {warned['text']} Try: {warned['commands'][0]}" in done.err
    with h5py.File(layers) as root:
        before = root["n_modes"][0]
    values = {"SOURCE": folder / "ranges.npy", "AMPLITUDES": folder / "amplitudes.npy", "HZ": "20e6"}
    words = [values.get(word, word) for word in shlex.split(warned["commands"][0])]
    assert words[0] == "tofmix"
    again = tofmix.done(*words[1:], *VIEW)
    assert "amplitudes" not in again.out.partition("not known")[2]
    done = tofmix("estimate", path, *QUICK, "--overwrite")
    assert "mixing: 100 % of the samples at edges are phasor sums" in done.err
    assert "flying pixels" not in done.err
    with h5py.File(layers) as root:
        mixed = root["mixing"][0] == int(Mixing.PHASOR)
        assert (root["n_modes"][0][mixed] == 2).sum() > 100
    assert (before[mixed] == 1).mean() > 0.5


def test_report_says_it_on_the_page_in_the_table_and_in_json(tofmix: Tofmix, folder: Path, tmp_path: Path) -> None:
    path, layers, page = tmp_path / "a.h5", tmp_path / "a.layers.h5", tmp_path / "a.html"
    tofmix("import", folder / "part.npy", "-o", path, "--sensor", "pico-flexx", *VIEW)
    tofmix("estimate", path, *QUICK, "--window", 12, "--quiet")
    done = tofmix("report", layers, "--recording", path, "--html", page, "--json")
    said = json.loads(done.out)
    assert CODE in [one["code"] for one in said["warnings"]]
    assert [one["code"] for one in said["notes"]] == ["few_frames"]
    text = page.read_text(encoding="utf-8")
    assert "The recording has no amplitudes and no modulation frequency: a lock-in camera" in text
    assert 'aria-label="Notes"' in text
    assert "12 frames a window; tofmix asks for 25 or more." in text
    assert "<code>tofmix estimate" in text
    table = tofmix("report", layers).out
    assert "warning: The recording has no modulation frequency:" in table
    assert "note: 12 frames a window; tofmix asks for 25 or more." in table


def test_the_kind_of_an_unknown_camera_stays_a_condition(tofmix: Tofmix, folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    made = tofmix("import", folder / "part.npy", "-o", path, "--units", "mm")
    assert "amplitudes (if this is a lock-in camera, flying pixels are counted as surfaces without" in made.out
    done = tofmix("estimate", path, *QUICK, "--json")
    said = json.loads(done.out)
    assert [one["code"] for one in said["notes"]] == ["mixing_not_measured"]
    assert CODE not in done.out
    assert done.err.count("If this is a lock-in camera, flying pixels are counted as surfaces.") == 1
    assert "lock-in" not in tofmix("estimate", path, *QUICK, "--overwrite", "--quiet").err
    assert "lock-in" not in tofmix("estimate", path, *QUICK, "--overwrite", "--mixing", "events").err


@pytest.mark.parametrize(
    "name", ["l515", pytest.param("tmf8829", marks=pytest.mark.slow), pytest.param("stoc", marks=pytest.mark.slow)]
)
def test_cameras_without_phase_are_never_called_lock_in(
    tofmix: Tofmix, folder: Path, tmp_path: Path, name: str
) -> None:
    path, layers = tmp_path / "a.h5", tmp_path / "a.layers.h5"
    source = ("import", folder / "part.npy", "-o", path, "--sensor", name, *VIEW)
    said = [
        tofmix(*source),
        tofmix("estimate", path, *QUICK, "--noise", "auto"),
        tofmix("report", layers),
        tofmix("info", path),
    ]
    assert [one.code for one in said] == [0] * 4
    for one in said:
        assert "lock-in" not in one.out + one.err
        assert "flying" not in one.out + one.err
    for refused, code in (
        (tofmix(*source, "--modulation-frequency", "2e7", "--overwrite"), ExitCode.USAGE),
        (tofmix("estimate", path, *QUICK, "--mixing", "phasor", "--overwrite"), ExitCode.BAD_INPUT),
    ):
        assert refused.code == code
        assert "is no lock-in camera (measurement: " in refused.err


def test_a_recording_of_its_own_gets_a_frequency_by_importing_it(tofmix: Tofmix, folder: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "a.h5", tmp_path / "b.h5"
    both = ("--amplitude", folder / "amplitudes.npy", *VIEW)
    tofmix.done("import", folder / "ranges.npy", "-o", first, "--sensor", "kinect-v2", *both)
    tofmix.done("import", first, "-o", second, "--modulation-frequency", "23.5e6")
    with h5py.File(first) as a, h5py.File(second) as b:
        assert np.isnan(a["sensor"].attrs["modulation_frequency_hz"])
        assert b["sensor"].attrs["modulation_frequency_hz"] == 23.5e6
        assert b["sensor"].attrs["measurement"] == "lock-in"
        np.testing.assert_array_equal(a["amplitude"], b["amplitude"])


def test_few_frames_are_said_once_and_listed_among_the_notes(tofmix: Tofmix, folder: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "few.npy", np.load(folder / "part.npy")[:13])
    path = tmp_path / "a.h5"
    tofmix("import", tmp_path / "few.npy", "-o", path, "--sensor", "l515", *VIEW)
    done = tofmix("estimate", path, *QUICK, "--json")
    (note,) = json.loads(done.out)["notes"]
    assert note["code"] == "few_frames"
    assert done.err.count("13 frames a window; tofmix asks for 25 or more.") == 1
    assert "less than 73 % are found with 13 frames, and 93 % with 25" in note["text"]


@pytest.mark.parametrize(("frames", "codes"), [(10, []), (8, ["few_frames"])])
def test_ten_frames_are_enough_where_light_adds_up(
    tofmix: Tofmix, folder: Path, tmp_path: Path, frames: int, codes: list[str]
) -> None:
    for name in ("ranges", "amplitudes"):
        np.save(tmp_path / f"{name}.npy", np.load(folder / f"{name}.npy")[:frames])
    path, light = tmp_path / "a.h5", ("--amplitude", tmp_path / "amplitudes.npy", "--modulation-frequency", "20e6")
    tofmix("import", tmp_path / "ranges.npy", "-o", path, *light, *VIEW)
    said = json.loads(tofmix("estimate", path, "--json").out)
    assert said["mixing"]["phasor_share"] > 0.9
    assert [one["code"] for one in said["notes"]] == codes


def test_python_warns_of_a_lock_in_camera_and_takes_the_remedy(folder: Path) -> None:
    ranges, light = (np.load(folder / f"{name}.npy") for name in ("ranges", "amplitudes"))
    noise = tm.NoiseCurve(np.array([1600.0, 3600.0]), np.array([5.0, 21.0]))
    known = tm.from_array(ranges, units="mm").with_sensor(measurement="lock-in")
    with pytest.warns(DoubtWarning, match="flying pixels.*from_array takes amplitude=..., with_sensor modulation_freq"):
        tm.estimate(known, noise=noise)
    full = tm.from_array(ranges, units="mm", amplitude=light).with_sensor(modulation_frequency_hz=20.0e6)
    made = tm.estimate(full, noise=noise)
    assert made.phasor_share is not None
    assert made.phasor_share[0] > 0.9


NOISE = {"noise_range": [500.0, 5000.0], "noise_sigma": [20.0, 20.0]}


def _wall(path: Path, *, factor: float = 1.0, drift: float = 0.0, frames: int = 60) -> Path:
    """A wall at 1.5 m whose noise is `factor` times the curve, and that moves by `drift` sigmas."""
    rng = np.random.default_rng(3)
    moved = drift * 20.0 * np.arange(frames)[:, None, None] / frames
    samples = 1500.0 + moved + rng.normal(0.0, factor * 20.0, (frames, 10, 12))
    return write_recording(path, np.rint(samples).astype("u2"), noise=NOISE)


def _codes(text: str) -> list[str]:
    return [finding["code"] for finding in json.loads(text)["warnings"]]


def test_sound_recording_gives_no_finding(tofmix: Tofmix, tmp_path: Path) -> None:
    done = tofmix.done("estimate", _wall(tmp_path / "a.h5"), "--mixing", "events", "--json")
    assert "a.h5" not in done.err
    assert json.loads(done.out)["warnings"] == []


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.2, 4.0])
def test_contradiction_of_the_curve_is_reported_and_its_remedy_works(
    tofmix: Tofmix, tmp_path: Path, factor: float
) -> None:
    recording = _wall(tmp_path / "a.h5", factor=factor)
    done = tofmix.done("estimate", recording, "--noise", "file")
    (line,) = [line for line in done.err.splitlines() if "Samples scatter" in line]
    assert f"scatter {factor:.1g}" in line
    assert ("averaged" in line) == (factor < 1)
    command = line.partition("Try: ")[2]
    assert command == f"tofmix estimate {recording} --noise auto --overwrite"
    again = tofmix.done(*shlex.split(command)[1:], "--json")
    assert _codes(again.out) == []


def test_drift_is_reported_and_its_remedy_works(tofmix: Tofmix, tmp_path: Path) -> None:
    done = tofmix("estimate", _wall(tmp_path / "a.h5", drift=8.0))
    assert "ranges drift by 8" in done.err
    assert "two layers within 5 sigma" in done.err
    (line,) = [line for line in done.err.splitlines() if "ranges drift by" in line]
    again = tofmix.done(*shlex.split(line.partition("Try: ")[2])[1:], "--json")
    assert _codes(again.out) == []


@pytest.mark.slow
def test_findings_equal_those_of_report_for_any_engine(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _wall(Path("a.h5"), drift=20.0, frames=80)
    with h5py.File("a.h5", "r+") as root:  # nothing to say about mixing
        root["sensor"].attrs["measurement"] = "pulses"
    given = "--noise", "file", "--window", 40, "--mixing", "events"
    once = tofmix("estimate", "a.h5", *given, "--workers", 1)
    lines = once.err.splitlines()
    assert [("drift by" in line, "two layers within" in line) for line in lines] == [
        (True, False),
        (False, True),
    ]
    assert tofmix("estimate", "a.h5", *given, "--workers", 3, "--overwrite").err == once.err
    assert tofmix("estimate", "a.h5", *given, "--resume").err.splitlines()[:1] == lines[:1]
    assert lines[1] in tofmix("estimate", "a.h5", *given, "--resume").err.splitlines()
    for number in (1, 2):
        part = tofmix("estimate", "a.h5", *given, "--shard", f"{number}/2")
        assert part.err.splitlines() == lines[:1]
    merged = tofmix("merge", "a.layers.1-of-2.part", "a.layers.2-of-2.part", "-o", "a.layers.h5", "--overwrite")
    assert merged.err.splitlines() == lines[1:]
    told = json.loads(tofmix("report", "a.layers.h5", "--json").out)["warnings"]
    said = [f"{w['text']} Try: {', or: '.join(w['commands'])}" if w["commands"] else w["text"] for w in told]
    assert [f"tofmix: a.layers.h5: {text}" for text in said] == lines[1:]
    told = json.loads(tofmix("report", "a.layers.h5", "--recording", "a.h5", "--json").out)["warnings"]
    assert [warning["code"] for warning in told] == ["drift", "close_layers"]


def test_recording_with_the_mark_averaged_is_refused_unless_it_is_0(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = _wall(tmp_path / "a.h5")
    for mark, code in ((1, ExitCode.BAD_INPUT), (0, ExitCode.DONE), (np.int64(1), ExitCode.BAD_INPUT)):
        with h5py.File(recording, "a") as root:
            root.attrs["averaged"] = mark
        done = tofmix("estimate", recording, "-o", tmp_path / f"{mark}.layers.h5", "--overwrite")
        assert done.code == code
        if code:
            assert "marked as averaged" in done.err
            assert "--force" in done.err
            assert not (tmp_path / "1.layers.h5").exists()
    tofmix.done("estimate", recording, "--force")
