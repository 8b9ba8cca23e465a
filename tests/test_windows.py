"""Planning windows, against brute force."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.windows import plan_windows


@given(n=st.integers(1, 60), window=st.integers(1, 60), stride=st.integers(1, 70))
def test_windows_equal_brute_force(n: int, window: int, stride: int) -> None:
    starts = [s for s in range(0, n, stride) if s + window <= n]
    if not starts:
        with pytest.raises(ValueError, match="longer than"):
            plan_windows(n, window=window, stride=stride)
        return
    plan = plan_windows(n, window=window, stride=stride)
    assert [plan.start(k) for k in range(plan.count)] == starts
    assert plan.frames_left_out == n - (starts[-1] + window)
    assert plan.stop(0) == window


def test_defaults_are_one_window_over_all() -> None:
    plan = plan_windows(17)
    assert (plan.count, plan.length, plan.frames_left_out) == (1, 17, 0)
    assert plan_windows(17, window=5).stride == 5


@pytest.mark.parametrize(("window", "stride"), [(0, 1), (1, 0), (-3, None)])
def test_windows_below_one_frame_are_refused(window: int, stride: int | None) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        plan_windows(10, window=window, stride=stride)
