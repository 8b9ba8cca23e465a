"""A command and its Python function say the same doubts, and refuse the same, of the same doubtful input."""

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from support.commandline import exit_code, signals_kept
from support.files import boards, write_recording

import tofmix as tm
from tofmix.errors import TofmixError

_NO_CURVE: dict[str, Any] = {}
_WIDE = {"noise_range": [500.0, 5000.0], "noise_sigma": [150.0, 150.0]}


class Doubtful(NamedTuple):
    """What makes a recording, options of the command, parameters of the function, and words of the doubt."""

    make: Callable[[Path], Path]
    options: tuple[str, ...]
    parameters: dict[str, Any]
    said: str


def _plain(path: Path, **changes: Any) -> Path:  # noqa: ANN401  what `write_recording` takes
    return write_recording(path, changes.pop("samples", boards(30)), **changes)


def _averaged(path: Path) -> Path:
    return tm.simulate("near-far", frames=3, averaged=True).save(path)


def _zeros(path: Path) -> Path:
    samples = boards(40, dtype="f4")
    samples[::4] = 0.0
    return _plain(path, samples=samples, units="mm")


ESTIMATES = {
    "samples beside the curve": Doubtful(
        lambda p: _plain(p, samples=boards(60, rows=12, cols=24), noise=_WIDE), ("--noise", "file"), {"noise": "file"}, "Samples scatter"
    ),
    "zeros": Doubtful(_zeros, (), {}, "exactly 0"),
    "frames left out": Doubtful(_plain, ("--window", "20"), {"window": 20}, "10 frames after the last whole window"),
    "no integration time": Doubtful(_plain, ("--noise", "sr3000"), {"noise": "sr3000"}, "taken at its default"),
}  # fmt: skip
REFUSED = {
    "averaged": Doubtful(_averaged, (), {}, "marked as averaged"),
    "phasors without amplitudes": Doubtful(_plain, ("--mixing", "phasor"), {"mixing": "phasor"}, "no amplitudes"),
    "no lock-in camera": Doubtful(
        lambda p: _plain(p, attributes={"measurement": "pulses"}), ("--mixing", "phasor"), {"mixing": "phasor"},
        "no lock-in camera",
    ),
    "no curve": Doubtful(
        lambda p: _plain(p, noise=_NO_CURVE), ("--noise", "file"), {"noise": "file"}, "no noise curve"
    ),
    "few frames": Doubtful(
        lambda p: _plain(p, samples=boards(4)), ("--noise", "auto"), {"noise": "auto"}, "at least 10"
    ),
    "stride without window": Doubtful(_plain, ("--stride", "5"), {"stride": 5}, "needs"),
    "outliers above 1": Doubtful(_plain, ("--outliers", "1.5"), {"outliers": 1.5}, "probability in [0, 1)"),
    "window too long": Doubtful(_plain, ("--window", "50"), {"window": 50}, "longer than the recording's 30"),
    "unknown camera": Doubtful(_plain, ("--noise", "sr9"), {"noise": "sr9"}, "unknown profile 'sr9'"),
    "camera of unknown noise": Doubtful(
        _plain, ("--noise", "tmf8829"), {"noise": "tmf8829"}, "is not known; auto measures it"
    ),
}  # fmt: skip


def _plainly(lines: list[str], path: Path) -> list[str]:
    """Lines without the recording's name and remedies of findings, and with options spelled in one way."""
    spelled = [re.sub(r"--([\w-]+)", lambda name: name[1].replace("-", "_"), line) for line in lines]
    spelled = [re.sub(r"(\w+)='(\w+)'", r"\1 \2", line).replace("=True", "") for line in spelled]
    names = "|".join(re.escape(str(place)) for place in (path, path.with_suffix(".layers.h5")))
    return [
        re.sub(rf"^(tofmix: )?(({names}): )?|( Try: | noise auto measures it\.| Take a ).*$", "", s) for s in spelled
    ]


def _of_command(path: Path, options: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    capsys.readouterr()
    with signals_kept():
        code = exit_code("estimate", path, *options, "--quiet")
    return code, _plainly(capsys.readouterr().err.splitlines(), path)


@pytest.mark.parametrize("name", ESTIMATES)
def test_estimate_warns_of_what_the_command_prints(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = ESTIMATES[name]
    path = case.make(tmp_path / "a.h5")
    code, printed = _of_command(path, case.options, capsys)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tm.estimate(path, **case.parameters)
    assert code == 0
    assert any(case.said in line for line in printed)
    assert _plainly([str(one.message) for one in caught], path) == printed
    assert {one.filename for one in caught} == {__file__}


@pytest.mark.parametrize("name", REFUSED)
def test_estimate_refuses_what_the_command_refuses(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = REFUSED[name]
    path = case.make(tmp_path / "a.h5")
    code, printed = _of_command(path, case.options, capsys)
    with pytest.raises(TofmixError, match=re.escape(case.said)) as refusal:
        tm.estimate(path, **case.parameters)
    assert int(refusal.value.exit_code) == code
    assert _plainly([str(refusal.value)], path) == printed
