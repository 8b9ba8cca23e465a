"""Real recordings against their own first third as the scene: nothing changed, so nothing is to be named.

The recordings and groups are those of `same`: frames in another order, and running medians over 3 and 5 of these. In
place of a model of a wall, the first third is estimated, as `tofmix reconcile --self` does.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from benchmarks.measured_parts import same
from benchmarks.measured_parts.judging import said_of

import tofmix as tm
from tofmix.errors import BadInputError
from tofmix.io.recording.recording_file import open_recording
from tofmix.jobs import reconcile as job
from tofmix.jobs.reference import SELF_SHARE, first_frames
from tofmix.jobs.reporter import Reporter
from tofmix.reconciliation.settings import KINDS, Settings

CASES = 300
"""100 permuted, 100 medians over 3, 100 medians over 5."""

order, table = same.order, same.table


def judged(number: int, seed: int) -> dict[str, Any] | None:
    """The result of one case; None where its recording is missing."""
    group, name = same.GROUPS[number % 3], list(same.RECORDINGS)[number // 3 % len(same.RECORDINGS)]
    rng = np.random.default_rng([seed, number])
    try:
        samples = same.RECORDINGS[name](rng)[: same.MOST_FRAMES]
    except FileNotFoundError:
        return None
    samples = same.in_group(same.part_of(samples, rng), group, rng)
    start = time.perf_counter()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        times = np.arange(len(samples)) / same.RATE_HZ
        tm.from_array(samples.astype(np.float32), units="mm", fov_deg=(40.0, 40.0), time_s=times).save(path)
        try:
            gap = _of_itself(path)
        except BadInputError as error:
            gap = {"verdict": "refused", "effects": [], "where": [], "next_steps": [str(error)]}
    said = said_of(gap, time.perf_counter() - start)
    return {"number": number, "group": group, "name": name, "frames": len(samples), **said}


def _of_itself(path: Path) -> dict[str, Any]:
    """The contents of gap.json of `tofmix reconcile --self`."""
    reporter = Reporter()
    reference = first_frames(path, SELF_SHARE, reporter, workers=1)
    with open_recording(path) as source:
        evidence = job.read_evidence(
            reference.model, source, reporter, time_s=source.read_time(), temperature_c=None, after=reference.frames
        )
    sensor = reference.model.sensor.sensor()
    found = job.reconcile([(reference.model, evidence)], Settings(kinds=KINDS), None, lambda: sensor, reporter)
    return found.as_dict()
