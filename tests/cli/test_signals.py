"""Ctrl-C and SIGTERM while an output is being written: the process dies of the signal, and nothing is left."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

FOV = {"fov_horizontal_deg": 40.0, "fov_vertical_deg": 30.0}
AT_COMMIT = """
import os, sys, time
from tofmix.io.storage import AtomicFile
number = int(sys.argv[1])
def stop(self):
    print(*os.listdir(self.path.parent), sep="\\n", flush=True)
    os.kill(os.getpid(), number)
    time.sleep(60)
AtomicFile.commit = stop
from tofmix.cli.start import run
sys.argv[:] = ["tofmix", *sys.argv[2:]]
run()
"""


@pytest.fixture
def folder(tofmix: Tofmix, tmp_path: Path) -> Path:
    recording = write_recording(tmp_path / "a.h5", boards(40), attributes=FOV)
    assert tofmix("estimate", recording, "--window", 20).code == 0
    np.save(tmp_path / "a.npy", boards(40))
    return tmp_path


@pytest.mark.parametrize(
    ("number", "arguments"),
    [
        pytest.param(
            signal.SIGINT,
            ("simulate", "near-far", "--frames", "3", "-o", "out.h5"),
            marks=[pytest.mark.compiled("a whole scene in another process"), pytest.mark.slow],
        ),
        (signal.SIGTERM, ("import", "a.npy", "-o", "out.h5", "--sensor", "sr3000")),
        pytest.param(
            signal.SIGINT, ("export", "a.layers.h5", "-o", "out.ply", "--window", "0"), marks=pytest.mark.slow
        ),
        pytest.param(signal.SIGTERM, ("map", "a.layers.h5", "-o", "out.yaml", "--cell", "500"), marks=pytest.mark.slow),
    ],
)
def test_signal_ends_each_command_without_leftovers(
    folder: Path, arguments: tuple[str, ...], number: signal.Signals
) -> None:
    before = sorted(folder.iterdir())
    program = [sys.executable, "-c", AT_COMMIT, str(int(number)), *arguments]
    start = time.monotonic()
    done = subprocess.run(program, capture_output=True, text=True, check=False, cwd=folder, timeout=120)
    assert done.returncode == -number, done.stderr
    assert ".tofmix-partial" in done.stdout  # it was there
    assert sorted(folder.iterdir()) == before
    assert done.stderr == ("tofmix: interrupted\n" if number == signal.SIGINT else "")
    assert time.monotonic() - start < 60  # and not when the block has ended


def test_ctrl_c_before_imports_gives_no_traceback(tmp_path: Path) -> None:
    program = (
        "import os, signal, sys\nfrom tofmix.cli.start import run\n"
        "class Stop:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'tofmix.cli.main':\n            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Stop())\nrun()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == -signal.SIGINT
    assert done.stderr == ""
