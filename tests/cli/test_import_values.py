"""`tofmix import`: values that are no samples, medians that no camera measures, and options that say otherwise."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix

from tofmix.errors import ExitCode

RNG = np.random.default_rng(11)


def wall_mm(frames: int = 12) -> np.ndarray:
    return np.rint(RNG.normal(1700.0, 5.0, (frames, 4, 5)))


def ranges_of(path: Path) -> np.ndarray:
    with h5py.File(path) as root:
        values = root["range"][...]
    return np.where(values == 0, np.nan, values) if values.dtype.kind == "u" else values


@pytest.mark.parametrize(
    ("dtype", "bad", "said"),
    [
        ("i2", -9, "12 negative"),
        ("i4", -1, "12 negative"),
        ("u2", 65535, "12 fill value 65535"),
        ("u2", 32768, "12 fill value 32768"),
        ("i4", 2**31 - 1, "12 fill value 2147483647"),
        ("f8", 3.0e15, "12 above 1e+09 mm"),
    ],
)
def test_values_that_are_no_ranges_are_dropped_and_counted(
    tofmix: Tofmix, tmp_path: Path, dtype: str, bad: float, said: str
) -> None:
    values = wall_mm().astype(dtype)
    values[:, 1, 2] = bad
    np.save(tmp_path / "a.npy", values)
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--units", "mm", "--json")
    assert done.code == 0
    made = json.loads(done.out)
    assert f"a.npy: no samples: {said} (--keep-values keeps fill values)" in done.err
    assert made["notes"] == [done.err.removeprefix("tofmix: ").strip()]
    assert list(made["dropped"].values()) == [12]
    assert np.isnan(ranges_of(tmp_path / "a.h5")).sum() == 12
    assert tofmix("verify", tmp_path / "a.h5").code == 0


def test_keep_values_keeps_zeros_and_fill_values_but_no_negative_range(tofmix: Tofmix, tmp_path: Path) -> None:
    values = wall_mm().astype("i4")
    values[:, 0, 0], values[:, 0, 1], values[:, 0, 2] = 0, 65535, -5
    np.save(tmp_path / "a.npy", values)
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--keep-values")
    assert done.code == 0
    found = ranges_of(tmp_path / "a.h5")
    np.testing.assert_array_equal(found[0, 0, :3], [0.0, 65535.0, np.nan])


def test_given_invalid_values_are_counted_without_a_note(tofmix: Tofmix, tmp_path: Path) -> None:
    values = wall_mm().astype("u2")
    values[:3, 1, 2] = 4444
    np.save(tmp_path / "a.npy", values)
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--invalid", "4444")
    assert (done.code, done.err) == (0, "")
    assert "no samples: 3 value 4444\n" in done.out


def test_source_in_another_unit_is_said_with_the_command_that_sets_it_right(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", wall_mm().astype("u4") * 1000)
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    assert done.code == 0
    assert "no camera sees so far; check the units; if the numbers are in micrometres: tofmix import" in done.err
    estimated = tofmix("estimate", tmp_path / "a.h5")
    assert estimated.code == 0
    assert "a.h5: range: half of the ranges are above 17" in estimated.err
    words = done.err.split("micrometres: ")[1].split()[1:]
    again = tofmix(*words[:-1], tmp_path / "b.h5")
    assert (again.code, again.err) == (0, "")
    assert abs(np.nanmedian(ranges_of(tmp_path / "b.h5")) - 1700.0) < 3.0


@pytest.mark.parametrize("text", ["status", "status=", "=5", "status=5,x"])
def test_valid_status_that_names_no_codes_is_refused(tofmix: Tofmix, tmp_path: Path, text: str) -> None:
    np.save(tmp_path / "a.npy", wall_mm())
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--valid-status", text)
    assert done.code == ExitCode.USAGE
    assert "is not NAME=CODE,..., such as status=5,9" in done.err


@pytest.mark.parametrize("text", ["y", "y=line", "=row", "a=row,b=row", ","])
def test_columns_without_a_known_meaning_are_refused(tofmix: Tofmix, tmp_path: Path, text: str) -> None:
    np.save(tmp_path / "a.npy", wall_mm())
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--columns", text)
    assert done.code == ExitCode.USAGE
    assert "--columns" in done.err


def test_scale_is_said_to_be_multiplied_by_the_factor_of_the_source_and_quiet_hides_that(
    tofmix: Tofmix, tmp_path: Path
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root["depth"] = np.full((4, 2, 3), 3000, dtype="u2")
        root["depth"].attrs["scale_factor"] = 0.5
    arguments = ("import", tmp_path / "a.h5", "-o", tmp_path / "b.h5", "--overwrite", "--scale", "0.2")
    done = tofmix(*arguments)
    assert done.code == 0, done.err
    said = "one stored number is 0.1 mm: --scale 0.2 times the source's scale_factor 0.5"
    assert done.err == f"tofmix: {tmp_path / 'a.h5'}: {said}\n"
    done = tofmix(*arguments, "--quiet", "--json")
    assert done.err == ""
    assert said in json.loads(done.out)["notes"][0]
    with h5py.File(tmp_path / "b.h5") as root:
        np.testing.assert_allclose(root["range"], 300.0)


def test_quiet_hides_how_a_source_is_read_and_keeps_doubts(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "frame,row,col,range_mm,amplitude_2,ir\n" + "".join(f"{k},0,0,{4 + k},1,2\n" for k in range(4))
    )
    loud = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "a.h5")
    quiet = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "b.h5", "--quiet")
    assert "ir" in loud.err
    assert "not used" in loud.err
    assert "not used" not in quiet.err
    for done in (loud, quiet):
        assert done.code == 0, done.err
        assert "no camera sees so near" in done.err


def test_columns_are_named_as_the_header_writes_them_and_codes_by_either_name(tofmix: Tofmix, tmp_path: Path) -> None:
    lines = [f"{k},0,{col},{60 + k},{5 if col else 7}" for k in range(5) for col in range(2)]
    (tmp_path / "a.csv").write_text("\n".join(["Shot,Y,X [px],Depth [cm],Flag (raw)", *lines]))
    arguments = (
        "import",
        tmp_path / "a.csv",
        "-o",
        tmp_path / "a.h5",
        "--overwrite",
        "--columns",
        "Shot=frame,Y=row,X [px]=col,Depth [cm]=range,Flag (raw)=status",
    )
    for name in ("Flag (raw)", "status", "flag_raw"):
        done = tofmix(*arguments, "--valid-status", f"{name}=5")
        assert done.code == 0, done.err
        values = ranges_of(tmp_path / "a.h5")[:, 0]
        assert np.isnan(values[:, 0]).all()
        np.testing.assert_allclose(values[:, 1], 600.0 + 10.0 * np.arange(5))


def test_zeros_and_nan_are_counted_without_a_note(tofmix: Tofmix, tmp_path: Path) -> None:
    values = wall_mm()
    values[:2, 0, 0], values[:, 3, 4] = 0.0, np.nan
    np.save(tmp_path / "a.npy", values)
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--units", "mm")
    assert (done.code, done.err) == (0, "")
    assert "no samples: 12 NaN, 2 zero\n" in done.out
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "b.h5", "--units", "mm", "--json")
    assert json.loads(done.out)["dropped"] == {"NaN": 12, "zero": 2}


def test_frame_rate_of_a_source_with_times_is_said_to_be_unused(tofmix: Tofmix, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", depth=wall_mm(), time=np.arange(12) * 0.25)
    done = tofmix("import", tmp_path / "a.npz", "-o", tmp_path / "a.h5", "--frame-rate", "30")
    assert done.code == 0
    assert "--frame-rate is not used: the frames have times" in done.err
    with h5py.File(tmp_path / "a.h5") as root:
        assert root["time"][1] == 0.25
