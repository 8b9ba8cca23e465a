"""`tofmix reconcile` with a recording as the reference: what it refuses, and what it writes."""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix

import tofmix as tm
from tofmix.errors import BadInputError
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of

SAMPLES = Path(__file__).parents[2] / "sample_data"


def _zone(path: Path, mean_mm: float, *, frames: int = 200, shape: tuple[int, int] = (1, 1), seed: int = 1) -> Path:
    """A recording of a zone sensor before a wall."""
    rng = np.random.default_rng(seed)
    samples = np.rint(rng.normal(mean_mm, 3.0, (frames, *shape)))
    tm.from_array(samples, units="mm", fov_deg=(25.0, 25.0), time_s=np.arange(frames) / 50.0).save(path)
    return path


def test_other_image_than_the_reference_is_refused(tofmix: Tofmix, tmp_path: Path) -> None:
    one, other = _zone(tmp_path / "one.h5", 500.0), _zone(tmp_path / "other.h5", 500.0, shape=(2, 2))
    shown = tofmix("reconcile", one, other, "-o", tmp_path / "gap", "--quiet")
    assert shown.code == 3
    assert "2 x 2 pixels; the reference has 1 x 1" in shown.err
    assert not (tmp_path / "gap").exists()


@pytest.mark.parametrize(
    ("share", "code", "said"),
    [("7", 3, "a reference needs 8"), ("0.99", 3, "both need 8"), ("9.5", 2, "a share")],
)
def test_reference_and_rest_need_eight_frames(tofmix: Tofmix, tmp_path: Path, share: str, code: int, said: str) -> None:
    recording = _zone(tmp_path / "a.h5", 500.0)
    shown = tofmix("reconcile", f"--self={share}", recording, "-o", tmp_path / "gap", "--quiet")
    assert shown.code == code
    assert said in shown.err


def test_messages_about_the_first_frames_name_the_recording(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = _zone(tmp_path / "a.h5", 500.0)
    with h5py.File(recording, "r+") as root:
        root.attrs["averaged"] = 1
    shown = tofmix("reconcile", "--self=0.5", recording, "-o", tmp_path / "gap", "--quiet")
    assert shown.code == 3
    assert f"{recording}: its first 100 frames: marked as averaged" in shown.err


@pytest.mark.parametrize("reference", ["--self", "first.h5", "model.toml"])
def test_missing_extra_is_said_before_anything_is_read(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reference: str
) -> None:
    """No file exists: what comes after would be refused for that."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    first = reference if reference == "--self" else tmp_path / reference
    shown = tofmix("reconcile", first, tmp_path / "measured.h5", "-o", tmp_path / "gap")
    shown.refused(2, "pip install 'tofmix[report]'")


def test_a_reference_that_does_not_exist_is_refused_with_what_may_be_one(tofmix: Tofmix, tmp_path: Path) -> None:
    measured, missing = _zone(tmp_path / "a.h5", 500.0), tmp_path / "missing.h5"
    said = f"{missing}: no such file; give a model (TOML), a recording or a layers file (HDF5), or a built-in model"
    tofmix("reconcile", missing, measured, "-o", tmp_path / "gap").refused(3, said)
    with pytest.raises(BadInputError, match="no such file; give a model"):
        tm.reconcile(missing, measured)
    shown = tofmix("reconcile", "--self", missing, "-o", tmp_path / "gap")
    assert shown.code == 3
    assert str(missing) in shown.err
    assert "model" not in shown.err


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.0, 0.25])
def test_still_full_image_of_flat_walls_agrees_with_itself(tofmix: Tofmix, tmp_path: Path, spread: float) -> None:
    """Thousands of pixels show skews, bends of the histogram and errors of widths that few pixels hide."""
    recording, rng = tmp_path / "walls.h5", np.random.default_rng(1)
    level = np.where(np.arange(120) < 60, 700.0, 2000.0)
    sigma = np.where(level > 1000, 8.0, 3.0) * np.exp(rng.normal(0.0, spread, (90, 120)))
    samples = rng.normal(np.tile(level, (90, 1)), sigma, (60, 90, 120))
    tm.from_array(samples.astype("f4"), units="mm", fov_deg=(8.0, 6.0), time_s=np.arange(60) / 30).save(recording)
    shown = tofmix("reconcile", "--self", recording, "-o", tmp_path / "gap", "--quiet", "--json")
    assert json.loads(shown.out)["verdict"] == "agree"


@pytest.mark.slow
def test_what_moves_unevenly_within_the_reference_too_has_its_speed_and_its_own_noise(
    tofmix: Tofmix, tmp_path: Path
) -> None:
    """A board shakes while it recedes, before a wall: widths of the reference hold its way."""
    rng, frames, speed_mm_s, noise_mm = np.random.default_rng(5), 60, 12.0, 2.0
    times_s = np.arange(frames) / 30.0
    way_mm = speed_mm_s * times_s + rng.normal(0.0, 1.0, frames)
    level = np.full((frames, 10, 10), 2000.0)
    level[:, :, :5] = 400.0 + way_mm[:, None, None]
    recording = tmp_path / "moving.h5"
    samples = rng.normal(level, np.where(level > 1000.0, 8.0, noise_mm))
    tm.from_array(samples.astype(np.float32), units="mm", fov_deg=(8.0, 8.0), time_s=times_s).save(recording)
    gap = tmp_path / "gap"
    tofmix("reconcile", "--self", recording, "-o", gap, "--effects", "motion,temperature_drift", "--max-effects", 1)
    found = json.loads((gap / "gap.json").read_text())
    (motion,) = found["effects"]
    assert found["verdict"] == "explained"
    assert motion["kind"] == "motion"
    error = motion["stderr"]["velocity_mm_s"]
    assert 0.02 < error < 1.5
    assert abs(motion["parameters"]["velocity_mm_s"] - speed_mm_s) < 3 * error
    assert found["gap"]["after"] < 1.5  # not so if the noise of the board were that of the reference, or too small


def test_self_takes_one_recording(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = _zone(tmp_path / "a.h5", 500.0)
    assert tofmix("reconcile", "--self=0.5", recording, recording, "-o", tmp_path / "gap").code == 2
    assert tofmix("reconcile", recording, "-o", tmp_path / "gap").code == 2


@pytest.mark.slow
def test_offset_since_the_reference_is_named_with_its_size(tofmix: Tofmix, tmp_path: Path) -> None:
    first, second = (
        _zone(tmp_path / f"{seed}.h5", mean_mm, frames=400, seed=seed) for seed, mean_mm in ((1, 500.0), (2, 504.0))
    )
    gap = tmp_path / "gap"
    tofmix.done("reconcile", first, second, "-o", gap)
    found = tm.reconcile(gap / "model.toml", second)
    assert found.verified.verdict == "agree"
    said = json.loads((gap / "gap.json").read_text())
    assert [n.effect.kind for n in tm.reconcile(first, second).named] == [e["kind"] for e in said["effects"]]
    assert (gap / "reference.layers.h5").is_file()
    text = (gap / "model.toml").read_text()
    assert 'layers = "reference.layers.h5"' in text
    assert 'kind = "range_offset"' in text
    offset = float(next(line for line in text.splitlines() if line.startswith("offset_mm")).split("=")[1])
    assert offset == pytest.approx(4.0, abs=1.0)
    assert tofmix("verify", gap).code == 0


@pytest.mark.slow
def test_random_values_beyond_the_reference_s_longest_range_are_named_with_their_share(
    tofmix: Tofmix, tmp_path: Path
) -> None:
    """The camera does not say how far it measures, and its first recording shows one wall only."""
    first = _zone(tmp_path / "first.h5", 500.0, shape=(4, 4), frames=80)
    rng = np.random.default_rng(4)
    samples = np.rint(rng.normal(500.0, 3.0, (80, 4, 4)))
    random = rng.random(samples.shape) < 0.05
    samples[random] = np.rint(rng.uniform(1.0, 2000.0, random.sum()))
    second = tmp_path / "second.h5"
    tm.from_array(samples, units="mm", fov_deg=(25.0, 25.0), time_s=np.arange(80) / 50.0).save(second)
    tofmix.done("reconcile", first, second, "-o", tmp_path / "gap")
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert [e["kind"] for e in gap["effects"]] == ["outliers"]
    assert gap["verdict"] == "explained"
    found, error = (gap["effects"][0][key]["probability"] for key in ("parameters", "stderr"))
    assert abs(found - random.mean()) < 3 * error
    assert tm.reconcile(tmp_path / "gap" / "model.toml", second).verified.verdict == "agree"


@pytest.mark.slow
def test_recording_agrees_with_its_own_first_frames(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = _zone(tmp_path / "a.h5", 500.0, shape=(4, 4), frames=60)
    shown = tofmix("reconcile", "--self", recording, "-o", tmp_path / "gap", "--quiet")
    assert shown.code == 0, shown.err
    assert "agree" in shown.out


@pytest.mark.slow
def test_a_static_image_with_edges_and_open_space_agrees_with_its_own_beginning(tofmix: Tofmix, tmp_path: Path) -> None:
    """Its mixed pixels have shares of few samples, and 33 frames do not show shares below 3 %."""
    shown = tofmix("reconcile", "--self", SAMPLES / "three_boards.h5", "-o", tmp_path / "gap")
    assert shown.code == 0
    assert "verdict      agree" in shown.out
    assert "pixels left out: a neighbour sees another surface" in shown.err


def _flight(path: Path, speed_mm_s: float, *, zones: int = 8, frames: int = 72) -> Path:
    """A recording of zones that move along their axis before a wall from the first frame on; some see nothing."""
    rng, time_s = np.random.default_rng(1), np.arange(frames) / 15.0
    depth_mm = 1500.0 + speed_mm_s * time_s[:, None, None] + rng.normal(0.0, 12.0, (frames, zones, zones))
    depth_mm[:, 0] = np.nan
    tm.from_array(depth_mm, units="mm", fov_deg=(45.0, 45.0), depth_axis="z", time_s=time_s).save(path)
    return path


@pytest.mark.slow
def test_motion_that_began_before_the_reference_is_named_with_its_speed(tofmix: Tofmix, tmp_path: Path) -> None:
    """Within the reference of 16 frames the wall moves by 17 sigma, and by 60 after it."""
    speed_mm_s = -200.0
    recording, folder = _flight(tmp_path / "a.h5", speed_mm_s), tmp_path / "gap"
    shown = tofmix("reconcile", "--self=16", recording, "-o", folder)
    assert shown.code == 0, shown.err
    assert f"its first 16 frames: ranges change by {speed_mm_s:+.0f}"[:-2] in shown.err
    assert "way_mm = " in (folder / "model.toml").read_text()
    gap = json.loads((folder / "gap.json").read_text())
    assert (gap["verdict"], [e["kind"] for e in gap["effects"]]) == ("explained", ["motion"])
    found, error = (gap["effects"][0][key]["velocity_mm_s"] for key in ("parameters", "stderr"))
    assert abs(found - speed_mm_s) < 3 * error + 0.01 * abs(speed_mm_s)


@pytest.mark.slow
def test_unsteady_motion_is_named_by_the_zones_that_follow_it_with_an_error_for_its_changing_speed(
    tofmix: Tofmix, tmp_path: Path
) -> None:
    """A drone leaves a wall: it speeds up and shakes, noise goes with range, and two rows soon see the floor."""
    rng, time_s = np.random.default_rng(5), np.arange(72) / 15.0
    way_mm = 400.0 * time_s + 25.0 * time_s**2 + rng.normal(0.0, 8.0, time_s.size)
    depth_mm = np.repeat(900.0 + way_mm, 64).reshape(-1, 8, 8)
    depth_mm += rng.standard_normal(depth_mm.shape) * 5.0 * (depth_mm / 900.0) ** 1.5
    depth_mm[25:, 6:] = 1300.0 + rng.normal(0.0, 12.0, (47, 2, 8))
    recording, folder = tmp_path / "a.h5", tmp_path / "gap"
    tm.from_array(depth_mm, units="mm", fov_deg=(45.0, 45.0), depth_axis="z", time_s=time_s).save(recording)
    shown = tofmix("reconcile", "--self=12", recording, "-o", folder)
    assert shown.code == 0, shown.err
    assert "16 pixels (within rows 6 to 7, columns 0 to 7) do not follow what moves, and were left out" in shown.out
    gap = json.loads((folder / "gap.json").read_text())
    assert gap["verdict"] in ("explained", "partly_explained")
    motion = next(e for e in gap["effects"] if e["kind"] == "motion")
    found, error = (motion[key]["velocity_mm_s"] for key in ("parameters", "stderr"))
    true = float(np.polyfit(time_s[12:], way_mm[12:], 1)[0])
    assert abs(found - true) < 0.1 * true
    assert abs(found - true) < 2 * error < 0.3 * true


def test_reference_without_a_whole_surface_is_compared(tofmix: Tofmix, tmp_path: Path) -> None:
    """Two zones in opposite corners see a wall, which is no plane of three points; one sees another wall behind it."""
    rng, far = np.random.default_rng(2), np.arange(160)[:, None, None] >= 80
    samples = np.full((160, 4, 4), np.nan)
    for row, col in ((0, 0), (3, 3)):
        samples[:, row, col] = rng.normal(1000.0, 5.0, 160)
    samples[::3, 0, 0] += 800.0
    recording = tmp_path / "a.h5"
    moved = samples + np.where(far, 20.0, 0.0)
    tm.from_array(moved, units="mm", fov_deg=(45.0, 45.0), time_s=np.arange(160) / 15.0).save(recording)
    shown = tofmix("reconcile", "--self=80", recording, "-o", tmp_path / "gap", "--effects", "range_offset")
    assert shown.code == 0, shown.err
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert gap["where"][0]["statistic"] in ("bias", "trend", "pattern")
    assert "verdict      agree" not in shown.out


@pytest.mark.slow
@pytest.mark.compiled("it reconciles recordings")
def test_a_new_box_is_told_and_an_offset_beside_it_is_named(tofmix: Tofmix, tmp_path: Path) -> None:
    rng, shape = np.random.default_rng(5), (12, 16)
    view = Equiangular(fov_horizontal_deg=40.0, fov_vertical_deg=30.0)
    slope = 1.0 / beam_directions_of(view, shape)[..., 2]  # of ranges to a plane that faces the camera
    box = np.zeros(shape, dtype=np.bool_)
    box[3:7, 5:10] = True
    for name, ahead_mm, offset_mm in (("first", 2000.0, 0.0), ("box", 1500.0, 0.0), ("offset", 1500.0, 6.0)):
        samples = np.where(box, ahead_mm, 2000.0) * slope + offset_mm + rng.normal(0.0, 5.0, (60, *shape))
        recording = tm.from_array(samples, units="mm", fov_deg=(40.0, 30.0), time_s=np.arange(60) / 20.0)
        recording.save(tmp_path / f"{name}.h5")
    said = {}
    for name in ("box", "offset"):
        shown = tofmix("reconcile", tmp_path / "first.h5", tmp_path / f"{name}.h5", "-o", tmp_path / name, "--quiet")
        assert "The scene has changed: something new stands" in shown.out
        said[name] = json.loads((tmp_path / name / "gap.json").read_text(encoding="utf-8"))
        (part,) = said[name]["changed"]
        assert (part["change"], part["surfaces"], part["rows"], part["cols"]) == ("new", ["surface 0"], [3, 6], [5, 9])
        assert ("col", [5, 9]) in [(place["axis"], place["interval"]) for place in said[name]["where"]]
        assert tofmix("verify", tmp_path / name).code == 0
    assert (said["box"]["verdict"], said["box"]["effects"]) == ("unexplained", [])
    assert said["offset"]["verdict"] == "partly_explained"
    (effect,) = said["offset"]["effects"]
    (name,) = effect["stderr"]  # of a wall that faces the camera, an offset is an alias of a pose
    assert (effect["kind"], name) in (("range_offset", "offset_mm"), ("surface_pose", "shift_mm"))
    assert effect["parameters"][name] == pytest.approx(6.0, rel=0.1)
