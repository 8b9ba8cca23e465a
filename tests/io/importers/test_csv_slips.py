"""CSV as people have it: headers, commas, encodings, codes, clocks and counters, with the notes on each guess."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.importers import open_source
from tofmix.io.importers.base import Frame, Request

RNG = np.random.default_rng(3)
WALL = np.rint(RNG.normal(900.0, 4.0, (6, 2, 3)))


def read(path: Path, **request: object) -> tuple[list[Frame], tuple[str, ...]]:
    with open_source(path, Request(**request)) as source:  # type: ignore[arg-type]
        frames = list(source.frames)
        assert len(frames) == source.shape[0]
        return frames, source.notes


def depths(frames: list[Frame]) -> NDArray[np.float64]:
    return np.stack([frame.depth for frame in frames])


def wide(mark: str = ",", text: Callable[[float], str] = lambda value: f"{value:g}") -> list[str]:
    return [mark.join(text(value) for value in image.ravel()) for image in WALL]


def long(*, frame: Callable[[int], int] = int, extra: Callable[[int, int, int], str] = lambda *_: "") -> list[str]:
    return [
        f"{frame(k)},{r},{c},{WALL[k, r, c]:g}{extra(k, r, c)}" for k in range(6) for r in range(2) for c in range(3)
    ]


def write(path: Path, lines: list[str], encoding: str = "utf-8") -> Path:
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


@pytest.mark.parametrize("head", ["0,1,2,3,4,5", "1,2,3,4,5,6"])
def test_first_line_that_counts_is_a_header_and_a_note(tmp_path: Path, head: str) -> None:
    frames, notes = read(write(tmp_path / "a.csv", [head, *wide()]), shape=(2, 3))
    np.testing.assert_array_equal(depths(frames), WALL)
    assert notes == (f"{tmp_path / 'a.csv'}: its first line, {head[0]} to {head[-1]}, is taken as a header",)


def test_index_column_of_a_table_is_no_pixel(tmp_path: Path) -> None:
    with_header = [",0,1,2,3,4,5", *(f"{k},{line}" for k, line in enumerate(wide()))]
    frames, _ = read(write(tmp_path / "a.csv", with_header), shape=(2, 3))
    np.testing.assert_array_equal(depths(frames), WALL)
    frames, notes = read(write(tmp_path / "b.csv", with_header[1:]), shape=(2, 3))
    np.testing.assert_array_equal(depths(frames), WALL)
    assert "first column, which counts the lines" in notes[0]


@pytest.mark.parametrize(("mark", "suffix"), [(";", "csv"), ("\t", "tsv"), (" ", "txt")])
def test_decimal_commas_are_read_with_a_note(tmp_path: Path, mark: str, suffix: str) -> None:
    lines = wide(mark, lambda value: f"{value / 1000:.3f}".replace(".", ","))
    frames, notes = read(write(tmp_path / f"a.{suffix}", lines), shape=(2, 3))
    np.testing.assert_allclose(depths(frames), WALL / 1000)
    assert any("decimal commas" in note for note in notes)


def test_utf_16_is_read_with_a_note(tmp_path: Path) -> None:
    frames, notes = read(write(tmp_path / "a.csv", ["frame,row,col,range_mm", *long()], "utf-16"))
    np.testing.assert_array_equal(depths(frames), WALL)
    assert notes == (f"{tmp_path / 'a.csv'}: read as UTF-16",)


def test_plain_files_have_no_notes(tmp_path: Path) -> None:
    assert read(write(tmp_path / "a.csv", wide()), shape=(2, 3))[1] == ()
    assert read(write(tmp_path / "b.csv", ["frame,row,col,range,time", *long(extra=lambda *_: ",0")]))[1] == ()


def test_columns_are_named_by_the_option(tmp_path: Path) -> None:
    lines = ["shot,y,x,depth_cm", *long()]
    with open_source(
        write(tmp_path / "a.csv", lines),
        Request(columns={"shot": "frame", "y": "row", "x": "col", "depth_cm": "range"}),
    ) as source:
        assert source.unit_mm == 10.0
        np.testing.assert_array_equal(depths(list(source.frames)), WALL)
    with pytest.raises(BadInputError, match=r"--columns: no column z; its header names: shot, y, x, depth_cm"):
        read(tmp_path / "a.csv", columns={"z": "range"})


@pytest.mark.parametrize("name", ["range [m]", "distance (m)", "Range_m"])
def test_unit_beside_the_name_of_a_column_is_used(tmp_path: Path, name: str) -> None:
    with open_source(write(tmp_path / "a.csv", [f"frame,row,col,{name}", *long()]), Request()) as source:
        assert source.unit_mm == 1000.0


def test_zone_takes_the_place_of_row_and_column(tmp_path: Path) -> None:
    lines = [f"{k},{3 * r + c},{WALL[k, r, c]:g}" for k in range(6) for r in range(2) for c in range(3)]
    path = write(tmp_path / "a.csv", ["frame,zone,range", *lines])
    np.testing.assert_array_equal(depths(read(path, shape=(2, 3))[0]), WALL)
    with pytest.raises(BadInputError, match=r"give their image: --shape ROWSxCOLS"):
        read(path)


def test_frames_are_told_by_their_times_where_they_have_no_number(tmp_path: Path) -> None:
    lines = [line.split(",", 1)[1] + f",{k // 6 / 30:.4f}" for k, line in enumerate(long())]
    frames, _ = read(write(tmp_path / "a.csv", ["row,col,range,time", *lines]))
    np.testing.assert_array_equal(depths(frames), WALL)
    np.testing.assert_allclose([frame.time_s or 0.0 for frame in frames], np.arange(6) / 30, atol=1e-4)


def test_frame_counter_that_starts_again_is_counted_on(tmp_path: Path) -> None:
    lines = long(frame=lambda k: k % 4)
    frames, notes = read(write(tmp_path / "a.csv", ["frame,row,col,range", *lines]))
    np.testing.assert_array_equal(depths(frames), WALL)
    assert any("its frame counter starts again once; the frames are counted on" in note for note in notes)


@pytest.mark.parametrize(
    ("name", "stamp", "unit", "said"),
    [
        ("time", "{0}", None, False),
        ("time_ms", "{1}", None, False),
        ("t_ns", "{2}", None, False),
        ("time", "{1}", 1e-3, False),
        ("timestamp", "1700000{1:06d}", None, True),  # ms since 1970
        ("time", "2024-05-01T00:00:0{0}", None, False),
    ],
)
def test_times_are_read_in_the_unit_of_their_name_their_size_or_the_option(
    tmp_path: Path, name: str, stamp: str, unit: float | None, *, said: bool
) -> None:
    lines = long(extra=lambda k, _r, _c: "," + stamp.format(k, k * 1000, k * 10**9))
    frames, notes = read(write(tmp_path / "a.csv", [f"frame,row,col,range,{name}", *lines]), time_unit_s=unit)
    times = np.array([frame.time_s for frame in frames], dtype=np.float64)
    np.testing.assert_allclose(times - times[0], np.arange(6), atol=1e-3)
    assert any("are taken as ms since 1970" in note for note in notes) == said


def test_times_that_would_be_far_apart_in_seconds_need_their_unit(tmp_path: Path) -> None:
    lines = long(extra=lambda k, _r, _c: f",{33 * k}")
    with pytest.raises(BadInputError, match=r"frames would be 33 s apart; give --time-unit ms"):
        read(write(tmp_path / "a.csv", ["frame,row,col,range,time", *lines]))


def test_status_codes_are_used_where_they_are_known_and_named_where_not(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", ["frame,row,col,range,status", *long(extra=lambda k, r, _: f",{5 if r else k}")])
    frames, notes = read(path)
    assert frames[0].status is None
    assert notes == (f"{path}: not used: column status (--valid-status status=5,9 says which codes are valid)",)
    for request in ({"status_codes": (5, 9)}, {"valid_status": ("status", (5, 9))}):
        with open_source(path, Request(**request)) as source:
            assert (source.status_valid, source.notes) == ((5, 9), ())
            codes = next(source.frames).status
            assert codes is not None
            assert codes.tolist() == [[0, 0, 0], [5, 5, 5]]
    with pytest.raises(BadInputError, match=r"no column 'state'; its header names: frame, row, col, range, status"):
        read(path, valid_status=("state", (1,)))


def test_cell_of_a_hundred_thousand_characters_is_refused_in_one_line(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", ["[" * 200_000 + ",1", *wide()])
    with pytest.raises(BadInputError, match=r"a\.csv: cannot be read: field larger than field limit"):
        read(path, shape=(2, 3))


@pytest.mark.parametrize("late_s", [0.0, 0.017])
def test_clock_that_restarts_with_the_frame_counter_is_marked_as_a_new_start(tmp_path: Path, late_s: float) -> None:
    stamp = [0.05 * (k % 3) + late_s * (k // 3) for k in range(6)]
    lines = long(frame=lambda k: k % 3, extra=lambda k, _r, _c: f",{stamp[k]:.3f}")
    frames, _ = read(write(tmp_path / "a.csv", ["frame,row,col,range,time_s", *lines]))
    np.testing.assert_array_equal(depths(frames), WALL)
    assert [frame.new_start for frame in frames] == [False, False, False, True, False, False]
