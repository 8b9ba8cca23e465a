"""Commands in processes of their own end without a signal: there, exit handlers of all C libraries run."""

import subprocess
import sys
from pathlib import Path

import pytest

from faults.fuzz import DONE
from faults.inject import CASES, inputs_into
from faults.originals import Original


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_command_ends_without_a_signal(originals: dict[str, Original], folder: Path, tmp_path: Path, case: str) -> None:
    assert originals
    inputs_into(folder, tmp_path)
    program = [sys.executable, "-m", "tofmix", *CASES[case].command.split()]
    done = subprocess.run(program, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode in DONE, done.stderr
    assert all((tmp_path / name).exists() for name in CASES[case].outputs)
