"""CSV as people have it, also with a sample a line: headers, commas, encodings, codes, clocks, and refusals."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.importers import csv_long, open_source
from tofmix.io.importers.base import Frame, SourceRequest
from tofmix.io.importers.csv_long import open_long
from tofmix.io.importers.csv_text import layout_of

NAMES = ["frame", "row", "col", "target", "range", "amplitude", "time"]


def _lines(frames: int, rows: int, cols: int) -> list[str]:
    """A line for each sample; of two targets, the second is missing in every third line."""
    lines = []
    for number, (frame, row, col, target) in enumerate(np.ndindex(frames, rows, cols, 2)):
        if target == 0 or number % 3:
            lines.append(f"{2 * frame + 7},{row},{col},{target},{1000 + number},{number % 50},{frame / 25}")
    return lines


def _read(path: Path, lines: list[str]) -> tuple[tuple[int, ...], int, list[Frame]]:
    path.write_text("\n".join([",".join(NAMES), *lines]))
    source = open_long(path, NAMES, layout_of(path), SourceRequest())
    return source.shape, source.targets, list(source.frames)


@given(
    size=st.tuples(st.integers(1, 6), st.integers(1, 4), st.integers(1, 4)),
    piece=st.integers(1, 40),
    seed=st.integers(0, 9),
)
def test_pieces_of_any_length_and_lines_in_any_order_give_the_same_frames(
    tmp_path_factory: pytest.TempPathFactory, size: tuple[int, int, int], piece: int, seed: int
) -> None:
    path, lines = tmp_path_factory.getbasetemp() / "a.csv", _lines(*size)
    shuffled = [lines[k] for k in np.random.default_rng(seed).permutation(len(lines))]
    whole = _read(path, lines)
    assert whole[:2] == (size, 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_long, "PIECE_LINES", piece)
        for found in (_read(path, lines), _read(path, shuffled)):
            assert found[:2] == whole[:2]
            for one, other in zip(found[2], whole[2], strict=True):
                np.testing.assert_array_equal(one.depth, other.depth)
                np.testing.assert_array_equal(np.asarray(one.amplitude), np.asarray(other.amplitude))
                assert one.time_s == other.time_s
    first = whole[2][0].depth.ravel()
    given_ = [float(line.split(",")[4]) for line in lines if line.startswith("7,")]
    assert sorted(first[np.isfinite(first)]) == sorted(given_)


def test_ascending_frames_are_never_held_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_long, "PIECE_LINES", 10)
    monkeypatch.setattr(csv_long, "MOST_WHOLE_BYTES", 0)
    lines = _lines(30, 2, 2)
    assert len(_read(tmp_path / "a.csv", lines)[2]) == 30
    with pytest.raises(
        BadInputError, match=r"longer than 0 GB, and its frames are not in order.*sort its lines by frame"
    ):
        _read(tmp_path / "a.csv", lines[::-1])


def test_duplicate_samples_in_two_pieces_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_long, "PIECE_LINES", 3)
    lines = ["0,0,0,0,10,1,0", "1,0,0,0,10,1,0", "1,0,1,0,10,1,0", "1,1,0,0,10,1,0", "1,0,1,0,11,1,0"]
    with pytest.raises(BadInputError, match="frame 1 has two samples of row 0, column 1, target 0"):
        _read(tmp_path / "a.csv", lines)


def test_invalid_cell_is_refused_with_the_number_of_samples_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_long, "PIECE_LINES", 4)
    lines = _lines(3, 2, 2)
    lines[6] = "zero," + lines[6].split(",", 1)[1]
    with pytest.raises(BadInputError, match=r"a\.csv: after 4 samples: cannot be read: .*zero"):
        _read(tmp_path / "a.csv", lines)


RNG = np.random.default_rng(3)
WALL = np.rint(RNG.normal(900.0, 4.0, (6, 2, 3)))


def read(path: Path, **request: object) -> tuple[list[Frame], tuple[str, ...]]:
    with open_source(path, SourceRequest(**request)) as source:  # type: ignore[arg-type]
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


def test_columns_are_named_by_the_option(tmp_path: Path) -> None:
    lines = ["shot,y,x,depth_cm", *long()]
    with open_source(
        write(tmp_path / "a.csv", lines),
        SourceRequest(columns={"shot": "frame", "y": "row", "x": "col", "depth_cm": "range"}),
    ) as source:
        assert source.unit_mm == 10.0
        np.testing.assert_array_equal(depths(list(source.frames)), WALL)
    with pytest.raises(BadInputError, match=r"--columns: no column z; its header names: shot, y, x, depth_cm"):
        read(tmp_path / "a.csv", columns={"z": "range"})


@pytest.mark.parametrize("theirs", ["range_mm", "distance_m", "range"])
def test_named_column_of_ranges_is_used_where_another_has_their_name(tmp_path: Path, theirs: str) -> None:
    lines = [f"{line},{4000 + k}" for k, line in enumerate(long())]
    path = write(tmp_path / "a.csv", [f"frame,row,col,{theirs},z_cm", *lines])
    with open_source(path, SourceRequest(columns={"z_cm": "range"})) as source:
        assert (source.unit_mm, source.notes) == (10.0, (f"{path}: not used: column {theirs}",))
        np.testing.assert_array_equal(depths(list(source.frames)).ravel(), 4000.0 + np.arange(36))


def test_named_columns_of_times_and_codes_are_used_where_others_have_their_names(tmp_path: Path) -> None:
    lines = long(extra=lambda k, r, _: f",{33 * k},{k / 8},255,{5 if r else 4}")
    path = write(tmp_path / "a.csv", ["frame,row,col,range,time_ms,clock_s,status,state", *lines])
    frames, notes = read(path, columns={"clock_s": "time", "state": "status"}, status_codes=(5, 9))
    assert [frame.time_s for frame in frames] == [k / 8 for k in range(6)]
    assert frames[0].status is not None
    assert frames[0].status.tolist() == [[4, 4, 4], [5, 5, 5]]
    assert notes == (f"{path}: not used: column time_ms, status",)


@pytest.mark.parametrize("name", ["range [m]", "distance (m)", "Range_m"])
def test_unit_beside_the_name_of_a_column_is_used(tmp_path: Path, name: str) -> None:
    with open_source(write(tmp_path / "a.csv", [f"frame,row,col,{name}", *long()]), SourceRequest()) as source:
        assert source.unit_mm == 1000.0


def test_zone_takes_the_place_of_row_and_column(tmp_path: Path) -> None:
    lines = [f"{k},{3 * r + c},{WALL[k, r, c]:g}" for k in range(6) for r in range(2) for c in range(3)]
    path = write(tmp_path / "a.csv", ["frame,zone,range", *lines])
    np.testing.assert_array_equal(depths(read(path, shape=(2, 3))[0]), WALL)
    with pytest.raises(BadInputError, match=r"give their image: --shape ROWSxCOLS"):
        read(path)


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
        with open_source(path, SourceRequest(**request)) as source:
            assert (source.status_valid, source.notes) == ((5, 9), ())
            codes = next(source.frames).status
            assert codes is not None
            assert codes.tolist() == [[0, 0, 0], [5, 5, 5]]
    with pytest.raises(BadInputError, match=r"no column 'state'; its header names: frame, row, col, range, status"):
        read(path, valid_status=("state", (1,)))


@pytest.mark.parametrize("late_s", [0.0, 0.017])
def test_clock_that_restarts_with_the_frame_counter_is_marked_as_a_new_start(tmp_path: Path, late_s: float) -> None:
    stamp = [0.05 * (k % 3) + late_s * (k // 3) for k in range(6)]
    lines = long(frame=lambda k: k % 3, extra=lambda k, _r, _c: f",{stamp[k]:.3f}")
    frames, _ = read(write(tmp_path / "a.csv", ["frame,row,col,range,time_s", *lines]))
    np.testing.assert_array_equal(depths(frames), WALL)
    assert [frame.new_start for frame in frames] == [False, False, False, True, False, False]


@pytest.mark.parametrize("first", ["901,N/A,903,-,905,906", "N/A,--,null,904,905,906", "nan,,?,904,905,906"])
def test_first_frame_with_lost_samples_is_no_header(tmp_path: Path, first: str) -> None:
    frames, notes = read(write(tmp_path / "a.csv", [first, *wide(), first]), shape=(2, 3))
    assert len(frames) == 8
    np.testing.assert_array_equal(frames[0].depth, frames[-1].depth)
    assert np.isnan(frames[0].depth).sum() in (2, 3)
    assert notes == ()


def test_word_among_numbers_of_the_first_line_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"line 1: cannot be read: could not convert string to float: '9O3'"):
        read(write(tmp_path / "a.csv", ["901,902,9O3,904,905,906", *wide()]), shape=(2, 3))


@pytest.mark.parametrize(
    ("lines", "shape", "wanted"),
    [
        (["0,1", "850,851", "852,853"], (1, 2), [850, 851, 852, 853]),
        (["1,2", "0.85,0.86", "1.5,2.0"], (1, 2), [0.85, 0.86, 1.5, 2]),
        ([",0,1", "0,850,851", "1,852,853"], (1, 2), [850, 851, 852, 853]),
        (["0", "850", "852"], (1, 1), [850, 852]),
        (["0", "0", "852"], (1, 1), [0, 0, 852]),  # a sample that is missing in two frames
        (["1,2", "3,2", "2,2"], (1, 2), [1, 2, 3, 2, 2, 2]),  # metres
    ],
)
def test_header_of_one_or_two_columns_is_told_by_the_lines_below(
    tmp_path: Path, lines: list[str], shape: tuple[int, int], wanted: list[float]
) -> None:
    frames, notes = read(write(tmp_path / "a.csv", lines), shape=shape)
    assert depths(frames).ravel().tolist() == wanted
    assert any("taken as a header" in note for note in notes) == (len(wanted) < len(lines) * shape[1])


@pytest.mark.parametrize(
    ("names", "unit_mm"),
    [
        ("d_cm_{}", 10.0),
        ("r{} [m]", 1000.0),
        ("zone {} (mm)", 1.0),
        ("depth_um_{}", 1e-3),
        ("m_{}", None),
        ("z{}", None),
    ],
)
def test_unit_in_the_names_of_all_pixels_is_used(tmp_path: Path, names: str, unit_mm: float | None) -> None:
    head = ",".join(["frame", *(names.format(k) for k in range(6))])
    path = write(tmp_path / "a.csv", [head, *(f"{k},{line}" for k, line in enumerate(wide()))])
    with open_source(path, SourceRequest(shape=(2, 3))) as source:
        assert source.unit_mm == unit_mm
        np.testing.assert_array_equal(depths(list(source.frames)), WALL)


def test_decimal_commas_in_quotes_are_read(tmp_path: Path) -> None:
    lines = [",".join(f'"{value:g},5"' for value in image.ravel()) for image in WALL]
    frames, notes = read(write(tmp_path / "a.csv", lines), shape=(2, 3))
    np.testing.assert_array_equal(depths(frames), WALL + 0.5)
    assert len(notes) == 1
    cells = [f'{line.rsplit(",", 1)[0]},"{line.rsplit(",", 1)[1]},5"' for line in long()]
    frames, _ = read(write(tmp_path / "b.csv", ["frame,row,col,range", *cells]))
    np.testing.assert_array_equal(depths(frames), WALL + 0.5)


@pytest.mark.parametrize(
    "stamp",
    ["31.12.2024 23:59:5{}", "2024/12/31 23:59:5{}.0", "2024-12-31T23:59:5{}Z", "9:59:5{},0", "0 days 01:02:0{}.00"],
)
@pytest.mark.parametrize("name", ["timestamp", "datetime"])
def test_dates_and_times_of_day_are_times(tmp_path: Path, name: str, stamp: str) -> None:
    lines = [f"{stamp.format(k // 6)};{line.split(',', 1)[1].replace(',', ';')}" for k, line in enumerate(long())]
    frames, notes = read(write(tmp_path / "a.csv", [f"{name};row;col;range", *lines]))
    np.testing.assert_array_equal(depths(frames), WALL)
    times = np.array([frame.time_s for frame in frames], dtype=np.float64)
    np.testing.assert_allclose(times - times[0], np.arange(6))
    assert notes == ()


def test_refusals_name_a_column_of_dates_as_the_time(tmp_path: Path) -> None:
    lines = [f"2024-12-31 10:00:0{line}" for line in long()]
    path = write(tmp_path / "a.csv", ["Zeit,row,col,range", *lines])
    with pytest.raises(BadInputError, match=r"names no frame; .*; --columns zeit=time has the frames told"):
        read(path)
    with pytest.raises(BadInputError, match=r"10:00:00 is a time, no frame; --columns zeit=time says so"):
        read(path, columns={"zeit": "frame"})
    np.testing.assert_array_equal(depths(read(path, columns={"zeit": "time"})[0]), WALL)


def test_date_that_can_be_read_in_two_ways_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", ["time,row,col,range", "05/01/2024 10:00:00,0,0,900"])
    with pytest.raises(BadInputError, match=r"05/01/2024"):
        read(path)


@pytest.mark.parametrize(
    ("encoding", "named"), [("utf-16-le", "UTF-16"), ("utf-16-be", "UTF-16"), ("cp1252", "Windows-1252")]
)
def test_other_encodings_are_read_with_a_note(tmp_path: Path, encoding: str, named: str) -> None:
    path = write(tmp_path / "a.csv", ["frame,row,col,range,t_\u00b5s", *long(extra=lambda *_: ",7")], encoding)
    frames, notes = read(path)
    np.testing.assert_array_equal(depths(frames), WALL)
    assert notes[1:] == (f"{path}: not used: column t_\u00b5s",)
    assert f"read as {named}" in notes[0]
