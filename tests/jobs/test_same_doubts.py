"""A command and its Python function say the same doubts, and refuse the same, of the same doubtful input."""

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest
from support.commandline import exit_code, signals_kept
from support.files import boards, wall_model, write_recording

import tofmix as tm
from tofmix.errors import TofmixError

WIDE = {"noise_range": [500.0, 5000.0], "noise_sigma": [150.0, 150.0]}
WALL = wall_model(12, 16, 40)

LEAVING = f"""\
{WALL.replace("frames", "frame_rate_hz = 1e-3" + chr(10) + "frames")}
[[effect]]
kind = "motion"
surface = "wall"
velocity_mm_s = 1000.0
"""
LONG = WALL.replace("rows", "integration_time_ms = 500.0\nrows")


class Doubtful(NamedTuple):
    """The inputs of a job, options of its command, parameters of its function, and words of the doubt."""

    job: str
    make: Callable[[Path], tuple[Path, ...]]
    options: dict[str, Any]
    said: str


def _recording(**changes: Any) -> Callable[[Path], tuple[Path]]:  # noqa: ANN401  what `write_recording` takes
    samples = changes.pop("samples", boards(30))
    return lambda folder: (write_recording(folder / "a.h5", samples, **changes),)


def _averaged(folder: Path) -> tuple[Path]:
    return (tm.simulate("near-far", frames=3, averaged=True).save(folder / "a.h5"),)


def _zeros() -> Callable[[Path], tuple[Path]]:
    samples = boards(40, dtype="f4")
    samples[::4] = 0.0
    return _recording(samples=samples, units="mm")


def _modelled(
    model: str = WALL, change: Callable[[h5py.File], object] = lambda _: None
) -> Callable[[Path], tuple[Path, Path]]:
    """A model and a recording of the wall, the file of which is changed."""

    def make(folder: Path) -> tuple[Path, Path]:
        paths = folder / "model.toml", folder / "a.h5"
        paths[0].write_text(WALL)
        tm.simulate(paths[0]).save(paths[1])
        paths[0].write_text(model)
        with h5py.File(paths[1], "r+") as root:
            change(root)
        return paths

    return make


def _model(text: str) -> Callable[[Path], tuple[Path]]:
    def make(folder: Path) -> tuple[Path]:
        (folder / "model.toml").write_text(text)
        return (folder / "model.toml",)

    return make


def _array(rows: int, cols: int, range_mm: float = 3000.0, first: float | None = None) -> Callable[[Path], tuple[Path]]:
    def make(folder: Path) -> tuple[Path]:
        values = np.full((5, rows, cols), range_mm)
        values[0] = range_mm if first is None else first
        np.save(folder / "a.npy", values)
        return (folder / "a.npy",)

    return make


def _slower(root: h5py.File) -> None:
    root["time"][...] *= 2.5


def _other_camera(root: h5py.File) -> None:
    root["sensor"].attrs["integration_time_ms"] = 7.5


def _all_invalid(root: h5py.File) -> None:
    root["range"][...] = np.nan


OFFSET = {"effects": "range_offset", "max_effects": 0}
DOUBTS = {
    "samples beside the curve": Doubtful(
        "estimate", _recording(samples=boards(60, rows=12, cols=24), noise=WIDE), {"noise": "file"}, "Samples scatter"
    ),
    "zeros": Doubtful("estimate", _zeros(), {}, "exactly 0"),
    "frames left out": Doubtful("estimate", _recording(), {"window": 20}, "10 frames after the last whole window"),
    "no integration time": Doubtful("estimate", _recording(), {"noise": "sr3000"}, "taken at its default"),
    "other frame rate": Doubtful("reconcile", _modelled(change=_slower), OFFSET, "the model has frame_rate_hz 25"),
    "other integration time": Doubtful("reconcile", _modelled(change=_other_camera), OFFSET, "integration_time_ms is"),
    "pattern without a map": Doubtful(
        "reconcile", _modelled(WALL + '[[effect]]\nkind = "fixed_pattern"\npixel_sigma_mm = 1.0\n'), OFFSET, "no map"
    ),
    "image of another size": Doubtful("import", _array(20, 30), {"sensor": "sr4000"}, "for this image"),
    "ranges beyond the camera": Doubtful(
        "import", _array(8, 8, 4400.0), {"sensor": "vl53l5cx"}, "outside the sensor's"
    ),
    "fill values": Doubtful("import", _array(8, 8, first=65535.0), {}, "fill value"),
    "metres": Doubtful("import", _array(8, 8, 1.5), {"units": "mm"}, "no camera sees so near"),
    "field of view in radians": Doubtful("import", _array(8, 8), {"fov": "1.2x0.9"}, "is narrow"),
}
REFUSALS = {
    "averaged": Doubtful("estimate", _averaged, {}, "marked as averaged"),
    "phasors without amplitudes": Doubtful("estimate", _recording(), {"mixing": "phasor"}, "no amplitudes"),
    "no lock-in camera": Doubtful(
        "estimate", _recording(attributes={"measurement": "pulses"}), {"mixing": "phasor"}, "no lock-in camera"
    ),
    "no curve": Doubtful("estimate", _recording(noise={}), {"noise": "file"}, "no noise curve"),
    "few frames": Doubtful("estimate", _recording(samples=boards(4)), {"noise": "auto"}, "at least"),
    "stride without window": Doubtful("estimate", _recording(), {"stride": 5}, "needs"),
    "outliers above 1": Doubtful("estimate", _recording(), {"outliers": 1.5}, "probability in [0, 1)"),
    "window too long": Doubtful("estimate", _recording(), {"window": 50}, "longer than the recording's 30"),
    "unknown camera": Doubtful("estimate", _recording(), {"noise": "sr9"}, "unknown profile 'sr9'"),
    "camera of unknown noise": Doubtful("estimate", _recording(), {"noise": "tmf8829"}, "is not known; auto"),
    "surface out of bounds": Doubtful("simulate", _model(LEAVING), {}, "motion: at 39000 s"),
    "averages of long samples": Doubtful("simulate", _model(LONG), {"averaged": True}, "integration"),
    "swapped rows and columns": Doubtful("import", _array(176, 144), {"sensor": "sr4000"}, "rows and columns"),
    "no surface": Doubtful("reconcile", _modelled(WALL[: WALL.index("[[surface]]")]), OFFSET, "has no surface"),
    "other image": Doubtful("reconcile", _modelled(WALL.replace("rows = 12", "rows = 13")), OFFSET, "12 x 16 pixels"),
    "no valid sample": Doubtful("reconcile", _modelled(change=_all_invalid), OFFSET, "no sample is valid"),
    "unknown effect": Doubtful("reconcile", _modelled(), {"effects": "wobble"}, '"wobble" is not an effect'),
    "window of a recording": Doubtful("scene", _recording(), {"planes": True, "window": 1}, "which is one window here"),
    "no view": Doubtful("scene", _recording(), {"planes": True}, "the directions of its pixels are not known"),
    "unknown noise": Doubtful("reconcile", _modelled(), {"noise": "no.h5"}, "not model, measured or a layers file"),
}


def _of_command(case: Doubtful, inputs: tuple[Path, ...], capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    """Exit code of the command, and the lines that it prints on stderr."""
    options = [
        f"--{name.replace('_', '-')}{'' if value is True else f'={value}'}" for name, value in case.options.items()
    ]
    output = [] if case.job == "estimate" else ["-o", inputs[0].with_name("out" if case.job == "reconcile" else "o.h5")]
    capsys.readouterr()
    with signals_kept():
        code = exit_code(case.job, *inputs, *output, *options, "--quiet")
    printed = [
        line for line in capsys.readouterr().err.splitlines() if "compiling the kernels" not in line
    ]  # first run
    return code, _plainly(printed, inputs)


def _in_python(case: Doubtful, inputs: tuple[Path, ...]) -> None:
    parameters: dict[str, Any] = {
        name: (value,) if name == "effects" else value for name, value in case.options.items()
    }
    parameters.pop("planes", None)  # the one form in Python
    if case.job == "import":
        if "fov" in parameters:
            parameters["fov_deg"] = tuple(float(part) for part in parameters.pop("fov").split("x"))
        tm.from_array(np.load(inputs[0]), **({"units": "mm"} | parameters))
    else:
        getattr(tm, case.job)(*inputs, **parameters)


def _plainly(lines: list[str], inputs: tuple[Path, ...]) -> list[str]:
    """Lines without the input's name and the remedies of findings, and with options spelled in one way."""
    spelled = [re.sub(r"--([\w-]+)", lambda name: name[1].replace("-", "_"), line) for line in lines]
    spelled = [re.sub(r"(\w+)='(\w+)'", r"\1 \2", line).replace("=True", "") for line in spelled]
    names = "|".join(re.escape(str(place)) for path in inputs for place in (path, path.with_suffix(".layers.h5")))
    names += "|from_array|ranges|fov(?=: )|fov_deg(?=: )"
    apart = rf"^(tofmix: )?(({names}): )*|( Try: | noise auto measures it\.| Take a |; in radians|; if the ).*$"
    apart += r"|(; give (their|ranges)|; keep_values| \(keep_values).*$"
    return [re.sub(apart, "", line) for line in spelled]


@pytest.mark.parametrize("case", DOUBTS.values(), ids=DOUBTS)
def test_python_warns_of_what_the_command_prints(
    case: Doubtful, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inputs = case.make(tmp_path)
    code, printed = _of_command(case, inputs, capsys)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        _in_python(case, inputs)
    assert code == 0
    assert any(case.said in line for line in printed)
    assert _plainly([str(one.message) for one in caught], inputs) == printed
    assert {one.filename for one in caught} == {__file__}


@pytest.mark.parametrize("case", REFUSALS.values(), ids=REFUSALS)
def test_python_refuses_what_the_command_refuses(
    case: Doubtful, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inputs = case.make(tmp_path)
    code, printed = _of_command(case, inputs, capsys)
    with pytest.raises((TofmixError, ValueError), match=re.escape(case.said)) as refusal:
        _in_python(case, inputs)
    if isinstance(refusal.value, TofmixError):
        assert int(refusal.value.exit_code) == code
    assert _plainly([str(refusal.value)], inputs) == printed
