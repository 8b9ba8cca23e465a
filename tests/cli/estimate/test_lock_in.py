"""Recordings of lock-in cameras without amplitudes or frequency: what is said, and that the remedy works."""

import json
import shlex
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.lock_in import small

import tofmix as tm
from tofmix.errors import DoubtWarning, ExitCode
from tofmix.flags import Mixing

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
    again = tofmix(*words[1:], *VIEW)
    assert again.code == 0, again.err
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


def test_a_frequency_that_no_camera_has_is_a_usage_error(tofmix: Tofmix, folder: Path, tmp_path: Path) -> None:
    made = tofmix("import", folder / "ranges.npy", "-o", tmp_path / "a.h5", "--modulation-frequency", "2e13")
    assert made.code == ExitCode.USAGE
    assert "--modulation-frequency: modulation_frequency_hz: 2e+13 is not between 1 Hz and 1 THz" in made.err
    assert not (tmp_path / "a.h5").exists()


def test_a_recording_of_its_own_gets_a_frequency_by_importing_it(tofmix: Tofmix, folder: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "a.h5", tmp_path / "b.h5"
    both = ("--amplitude", folder / "amplitudes.npy", *VIEW)
    assert tofmix("import", folder / "ranges.npy", "-o", first, "--sensor", "kinect-v2", *both).code == 0
    assert tofmix("import", first, "-o", second, "--modulation-frequency", "23.5e6").code == 0
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


def test_the_longer_window_that_a_note_advises_has_frames_enough(tofmix: Tofmix, folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    tofmix("import", folder / "part.npy", "-o", path, "--sensor", "l515", *VIEW)
    (note,) = json.loads(tofmix("estimate", path, *QUICK, "--window", 14, "--json").out)["notes"]
    again = tofmix(*shlex.split(note["commands"][0])[1:], "--json")
    assert json.loads(again.out)["window_frames"] == 25
    assert json.loads(again.out)["notes"] == []


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
