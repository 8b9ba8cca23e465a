"""docs/how-to/cluster.md does what it says: the tasks of its job array run in a shell loop, and are merged."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.commandline import succeed
from support.files import boards, write_recording

PAGE = (Path(__file__).parents[2] / "docs/how-to/cluster.md").read_text()


def script(name: str) -> str:
    found = re.search(rf"<!-- ci:{name} -->\n```sh\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[1]


@pytest.mark.slow
@pytest.mark.compiled("it estimates whole images in other processes")
def test_merged_tasks_of_the_array_give_the_bytes_of_one_run(tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "recording.h5", boards(200, 12, 16))
    (tmp_path / "task.sh").write_text(script("array"))
    (tmp_path / "tofmix").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tofmix "$@"\n')
    (tmp_path / "tofmix").chmod(0o755)
    # Task 2 is started twice, as after a failure of its node.
    loop = (
        "set -e; export SLURM_ARRAY_TASK_COUNT=2\n"
        f"for task in 2 1 2; do SLURM_ARRAY_TASK_ID=$task bash task.sh; done\n{script('merge')}\n"
    )
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    tasks = subprocess.run(
        ["/bin/bash", "-c", loop], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert tasks.returncode == 0, tasks.stderr
    whole = tmp_path / "whole.layers.h5"
    succeed("estimate", recording, "--window", 50, "-o", whole)
    assert (tmp_path / "recording.layers.h5").read_bytes() == whole.read_bytes()
