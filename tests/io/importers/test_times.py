"""Times of frames: units, and the order in which a recording holds them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.io.importers.times import epoch_unit_s, settled, time_unit_s


def distinct(count: int) -> np.ndarray:
    return np.zeros(count, dtype=np.bool_)


@pytest.mark.parametrize(
    ("text", "unit_s"),
    [("s", 1.0), ("ms", 1e-3), ("Seconds", 1.0), ("milliseconds since 2021-05-01 00:00:00", 1e-3), ("µs", 1e-6),
     ("ns", 1e-9), ("days since 1970-01-01", 86400.0), ("fortnight", None), ("", None)],
)  # fmt: skip
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
    found = settled(times[place], distinct(count))
    np.testing.assert_array_equal(place[found.order], np.arange(count))
    np.testing.assert_allclose(found.time_s, times - times[0], atol=1e-9)


@given(
    stamps=st.lists(st.one_of(st.floats(-1e4, 1e4), st.just(float("nan")), st.sampled_from([0.0, 1.0])), min_size=1),
    seed=st.integers(0, 9),
)
def test_times_ascend_from_0_whatever_the_stamps_are(stamps: list[float], seed: int) -> None:
    same = np.random.default_rng(seed).uniform(size=len(stamps)) < 0.2
    same[0] = False
    found = settled(np.array(stamps), same)
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
