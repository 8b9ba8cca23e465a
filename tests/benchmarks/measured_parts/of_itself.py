"""A recording against its own first frames as the scene, as `tofmix reconcile --self` does."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from benchmarks.measured_parts.judging import said_of
from benchmarks.measured_parts.same import RATE_HZ

import tofmix as tm
from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.io.recording.recording_file import open_recording
from tofmix.jobs import reconcile as job
from tofmix.jobs.reference import SELF_SHARE, first_frames
from tofmix.jobs.reporter import Reporter
from tofmix.reconciliation.settings import KINDS, Settings

VIEW_DEG = 40.0
"""Field of view of all recordings, both ways."""


def of_itself(
    samples: FloatArray,
    wanted: float = SELF_SHARE,
    times_s: FloatArray | None = None,
    *,
    view_deg: float = VIEW_DEG,
) -> dict[str, Any]:
    """What is noted of samples (frame, row, col) against their first frames: a share, or a number of frames."""
    start = time.perf_counter()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        stamps = np.arange(len(samples)) / RATE_HZ if times_s is None else times_s
        tm.from_array(samples.astype(np.float32), units="mm", fov_deg=(view_deg, view_deg), time_s=stamps).save(path)
        try:
            gap = _reconciled(path, wanted)
        except BadInputError as error:
            gap = {"verdict": "refused", "effects": [], "where": [], "next_steps": [str(error)]}
    return said_of(gap, time.perf_counter() - start)


def _reconciled(path: Path, wanted: float) -> dict[str, Any]:
    reporter = Reporter()
    reference = first_frames(path, wanted, reporter, workers=1)
    with open_recording(path) as source:
        evidence = job.read_evidence(
            reference.model, source, reporter, time_s=source.read_time(), temperature_c=None, after=reference.frames
        )
    sensor = reference.model.sensor.sensor()
    found = job.reconcile([(reference.model, evidence)], Settings(kinds=KINDS), None, lambda: sensor, reporter)
    return found.as_dict()
