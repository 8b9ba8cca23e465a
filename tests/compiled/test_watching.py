"""Who is told of compiling: the last that watches, or the log."""

import logging

import pytest

from tofmix.compiled import watching
from tofmix.compiled.jit import jit
from tofmix.compiled.watching import FIRST_RUN, Unwatched, watched, watcher

pytestmark = pytest.mark.compiled("nothing is compiled")


class _Recorder(Unwatched):
    def __init__(self) -> None:
        self.events: list[str] = []

    def begins(self, kernel: str) -> None:
        self.events.append(f"begins {kernel.rpartition('.')[2]}")

    def ends(self, kernel: str) -> None:
        self.events.append(f"ends {kernel.rpartition('.')[2]}")


def test_a_watcher_is_told_when_a_kernel_is_compiled_and_only_then() -> None:
    @jit
    def thrice(value: float) -> float:
        return 3 * value + hash(recorder_name)

    recorder_name = object().__hash__()  # another constant in each run: nothing kept fits
    recorder = _Recorder()
    with watched(recorder):
        thrice(1)
        thrice(2)
    thrice(1.5)
    assert recorder.events == ["begins thrice", "ends thrice"]


def test_the_log_has_one_line_where_nobody_watches(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(watching, "_watchers", [watching._Log()])
    with caplog.at_level(logging.WARNING, logger="tofmix"):
        for kernel in ("a.b", "a.c"):
            watcher().begins(kernel)
            watcher().ends(kernel)
    assert caplog.messages == [f"tofmix: {FIRST_RUN}"]
