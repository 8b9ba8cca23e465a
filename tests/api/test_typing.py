"""What type checkers say of calls of the public functions, and the lists that the program checks itself."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

import pytest

from tofmix import options
from tofmix.estimation.settings import MixingChoice, Refine, SigmaMode
from tofmix.io.units import UNITS_MM

RIGHT = """\
import tofmix as tm
recording = tm.from_array([[[1.0]]], units="m")
tm.estimate(recording, sigma="tied", refine="likelihood", mixing="auto", noise_shape="gaussian", noise_widths="own")
"""
WRONG = ('sigma="tide"', 'refine="none "', 'mixing="phasors"', 'noise_shape="gauss"', 'noise_widths="both"')


def test_the_names_for_type_checkers_are_those_that_the_program_takes() -> None:
    assert set(get_args(options.Sigma)) == set(SigmaMode)
    assert set(get_args(options.Refine)) == set(Refine)
    assert set(get_args(options.Mixing)) == set(MixingChoice)
    assert set(get_args(options.Units)) == set(UNITS_MM)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("mypy") is None, reason="mypy is not installed")
def test_mypy_refuses_names_that_there_are_not(tmp_path: Path) -> None:
    (tmp_path / "right.py").write_text(RIGHT)
    (tmp_path / "wrong.py").write_text(
        "import tofmix as tm\n" + "".join(f'tm.estimate("a.h5", {argument})\n' for argument in WRONG)
    )

    command = [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "right.py", "wrong.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    lines = {name: [line for line in done.stdout.splitlines() if line.startswith(name)] for name in command[-2:]}
    assert lines["right.py"] == []
    assert len(lines["wrong.py"]) == len(WRONG), done.stdout
