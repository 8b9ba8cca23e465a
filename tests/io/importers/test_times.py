"""Times of frames: units, and the order in which a recording holds them."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.io.importers.times import epoch_unit_s, settled, time_unit_s, times_of_array, unit_of_stamps


def distinct(count: int) -> np.ndarray:
    return np.zeros(count, dtype=np.bool_)


@pytest.mark.parametrize(
    ("text", "unit_s"),
    [
        ("s", 1.0),
        ("ms", 1e-3),
        ("Seconds", 1.0),
        ("milliseconds since 2021-05-01 00:00:00", 1e-3),
        ("µs", 1e-6),
        ("ns", 1e-9),
        ("days since 1970-01-01", 86400.0),
        ("fortnight", None),
        ("", None),
    ],
)
def test_units_of_time_are_read_as_cf_and_people_write_them(text: str, unit_s: float | None) -> None:
    assert time_unit_s(text) == unit_s


@pytest.mark.parametrize("unit_s", [1.0, 1e-3, 1e-6, 1e-9])
def test_unit_of_stamps_since_1970_follows_from_their_size(unit_s: float) -> None:
    assert epoch_unit_s(1.71e9 / unit_s) == unit_s
    assert epoch_unit_s(12.0) is None


@given(seed=st.integers(0, 500), count=st.integers(2, 60), rate=st.sampled_from([0.2, 5.0, 30.0]))
def test_frames_of_a_regular_clock_in_any_order_are_sorted(seed: int, count: int, rate: float) -> None:
    rng = np.random.default_rng(seed)
    times = np.arange(count) / rate + rng.uniform(0, 0.2 / rate, count)
    place = rng.permutation(count)
    assume((np.diff(place) < 0).sum() >= (count - 1) / 3)  # rarer steps back may be those of a clock that is set
    found = settled(times[place], distinct(count))
    np.testing.assert_array_equal(place[found.order], np.arange(count))
    np.testing.assert_allclose(found.time_s, times - times[0], atol=1e-9)


@given(
    stamps=st.lists(
        st.one_of(
            st.floats(-1e4, 1e4), st.just(float("nan")), st.sampled_from([0.0, 1.0]), st.floats(-9e9, 9e9), st.floats()
        ),
        min_size=1,
    ),
    seed=st.integers(0, 9),
)
def test_times_ascend_from_0_whatever_the_stamps_are(stamps: list[float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    same = rng.uniform(size=len(stamps)) < 0.2
    same[0] = False
    found = settled(np.array(stamps), same, np.flatnonzero(rng.uniform(size=len(stamps)) < 0.1))
    assert found.time_s[0] == 0.0
    assert np.isfinite(found.time_s).all()
    assert (np.diff(found.time_s) > 0).all()
    np.testing.assert_array_equal(np.sort(found.order), np.flatnonzero(~same))


def test_clock_that_is_set_back_goes_on_one_interval_later() -> None:
    stamps = np.r_[100.0 + np.arange(20) / 10, 3.0 + np.arange(10) / 10]
    found = settled(stamps, distinct(30))
    np.testing.assert_array_equal(found.order, np.arange(30))
    np.testing.assert_allclose(found.time_s, np.arange(30) / 10, atol=1e-9)
    assert found.remarks == ("the clock is set back at frame 20; its frames follow one interval later",)


def test_clock_that_starts_again_over_the_same_times_goes_on() -> None:
    count = 12
    stamps = np.r_[np.arange(count) / 4, np.arange(count) / 4]
    found = settled(stamps, distinct(2 * count))
    np.testing.assert_allclose(found.time_s, np.arange(2 * count) / 4)


def test_equal_frame_of_the_same_time_goes_and_another_one_lies_between() -> None:
    stamps = np.array([0.0, 0.1, 0.1, 0.2, 0.2, 0.3])
    found = settled(stamps, np.array([False, False, True, False, False, False]))
    np.testing.assert_array_equal(found.order, [0, 1, 3, 4, 5])
    np.testing.assert_allclose(found.time_s, [0.0, 0.1, 0.2, 0.25, 0.3])
    assert found.remarks == (
        "1 frame equal to another of the same time left out",
        "1 frame of a time that another has; their times are put between",
    )


def test_ascending_times_are_kept_without_a_remark() -> None:
    found = settled(np.array([7.0, 7.5, 9.0]), distinct(3))
    np.testing.assert_array_equal(found.time_s, [0.0, 0.5, 2.0])
    assert found.remarks == ()


def runs(*first_and_count: tuple[float, int], step: float = 0.1) -> FloatArray:
    return np.concatenate([first + step * np.arange(count, dtype=np.float64) for first, count in first_and_count])


@pytest.mark.parametrize(
    ("stamps", "starts"),
    [
        (runs((0.0, 80), (0.04, 80)), "frame 80"),  # between the first run's frames
        (runs((7.0, 60), (0.07, 40), (0.02, 70)), "frames 60, 100"),
        (runs((30.0, 90), (12.0, 90)), "frame 90"),  # wholly before the first run
        (runs((0.0, 6), (0.2, 6), (0.1, 5), (0.3, 7), step=0.4), "frames 6, 12, 17"),
        (np.delete(runs((0.0, 100), (0.05, 100)), [3, 40, 41, 77, 130]), "frame 96"),  # with frames lost
    ],
)
def test_clock_that_is_set_back_is_a_new_start_at_any_phase(stamps: np.ndarray, starts: str) -> None:
    found = settled(stamps, distinct(stamps.size))
    np.testing.assert_array_equal(found.order, np.arange(stamps.size))
    assert found.remarks == (f"the clock is set back at {starts}; its frames follow one interval later",)
    steps = np.diff(found.time_s)
    assert steps.min() > 0.9 * np.median(steps)


@pytest.mark.parametrize("step", [0.05, 2.0])
@pytest.mark.parametrize(
    "place",
    [
        sorted(range(120), key=str),  # names of files, as text
        [*range(30), 45, *range(30, 45), *range(46, 90)],  # one message 15 frames too early
        [*range(20), *range(50, 70), *range(20, 50), *range(70, 90)],  # a part too early
    ],
)
def test_frames_of_one_clock_in_few_parts_are_sorted(step: float, place: list[int]) -> None:
    found = settled(step * np.array(place), distinct(len(place)))
    assert found.order.tolist() == list(np.argsort(place))
    np.testing.assert_allclose(found.time_s, step * np.arange(len(place)), atol=1e-9)


def test_clock_that_starts_again_where_the_source_counts_anew_goes_on() -> None:
    stamps = runs((0.0, 25), (0.03, 25), (0.01, 25), step=0.02)  # by less than a second
    found = settled(stamps, distinct(stamps.size), np.array([25, 50]))
    np.testing.assert_array_equal(found.order, np.arange(75))
    np.testing.assert_allclose(found.time_s, 0.02 * np.arange(75), atol=1e-9)
    assert found.remarks == (
        "the clock starts again with the count of frames at frames 25, 50; its frames follow one interval later",
    )


def test_clock_that_goes_on_where_the_source_counts_anew_is_kept() -> None:
    found = settled(np.array([0.0, 0.1, 0.1, 0.3, 0.4]), distinct(5), np.array([3]))
    np.testing.assert_allclose(found.time_s, [0.0, 0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("stamp", [0.0, 1.6e9, 3.0e18, 1e300, -1e12])
def test_one_damaged_stamp_is_missing_and_its_frame_stays_in_place(stamp: float) -> None:
    stamps = 50.0 + 0.1 * np.arange(30, dtype=np.float64)
    stamps[17] = stamp
    found = settled(stamps, distinct(30))
    np.testing.assert_array_equal(found.order, np.arange(30))
    np.testing.assert_allclose(found.time_s, 0.1 * np.arange(30), atol=1e-9)
    assert len(found.remarks) == 2


@pytest.mark.parametrize(
    ("step", "offset", "unit_s"),
    [(0.04, 0.0, 1.0), (0.04, 1.65e9, 1.0), (40, 1_650_000_000_000, 1e-3), (4 * 10**7, 165 * 10**16, 1e-9)],
)
def test_unit_of_stamps_is_told_by_their_size(step: float, offset: float, unit_s: float) -> None:
    stored = (offset + step * np.arange(20)).astype(np.float64)
    found, notes = unit_of_stamps(stored, "a: time")
    assert found == unit_s
    assert len(notes) == (unit_s != 1.0)
    times, said = times_of_array(stored, 20, "a: time")
    np.testing.assert_allclose(times - times[0], 0.04 * np.arange(20), atol=1e-6)
    assert said == notes


@pytest.mark.parametrize(
    ("step", "offset", "text"), [(40, 0, "--time-unit ms"), (40_000, 7, "--time-unit us"), (4e7, 1e9, "--time-unit ns")]
)
def test_unit_of_stamps_that_would_be_far_apart_is_asked_for(step: float, offset: float, text: str) -> None:
    with pytest.raises(BadInputError, match=f"a: time: no unit, and frames would be .* s apart; give {text}"):
        times_of_array(offset + step * np.arange(20), 20, "a: time")
    times, _ = times_of_array(step * np.arange(3), 3, "a: time", 1e-3)
    np.testing.assert_allclose(times, step * 1e-3 * np.arange(3))


@pytest.mark.parametrize("kind", ["ms", "us", "ns"])
def test_dates_and_durations_of_numpy_are_times(kind: str) -> None:
    steps = (np.arange(6) * 50).astype("m8[ms]").astype(f"m8[{kind}]")
    for stored in (steps, np.datetime64("2023-11-05T23:59:59", "s") + steps):
        times, notes = times_of_array(stored, 6, "a: time")
        np.testing.assert_allclose(times, 0.05 * np.arange(6), atol=1e-12)
        assert notes == ()
    stored[2] = "NaT"
    assert np.isnan(times_of_array(stored, 6, "a: time")[0]).tolist() == [False, False, True, False, False, False]
