"""A case of the benchmark, reconciled: what every part does and notes."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from tofmix.arrays import Float32Array, FloatArray
from tofmix.errors import BadInputError
from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

FAR_MM = 200.0
"""A pose that moves a wall further than this is no pose."""


def reconciled(
    model: Model,
    range_mm: Float32Array,
    *,
    time_s: FloatArray | None = None,
    amplitude: Float32Array | None = None,
) -> dict[str, Any]:
    """Verdict, names and time of one recording (frame, row, col) against a model; a refusal is a verdict of its own."""
    start = time.perf_counter()
    try:
        evidence = make_evidence(model, range_mm, time_s=time_s, amplitude=amplitude)
        gap = reconcile(model, evidence, Settings(kinds=KINDS)).as_dict()
    except BadInputError as error:
        gap = {"verdict": "refused", "effects": [], "where": [], "next_steps": [str(error)]}
    return said_of(gap, time.perf_counter() - start)


def said_of(gap: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """What a part notes of `gap.json`."""
    return {
        "verdict": gap["verdict"],
        "named": sorted(e["kind"] for e in gap["effects"]),
        "effects": [{key: e[key] for key in ("kind", "parameters", "stderr")} for e in gap["effects"]],
        "aliases": [{"kinds": a["kinds"]} for a in gap.get("aliases", ())],
        "where": gap["where"][:3],
        "next": list(gap["next_steps"]),
        "seconds": round(seconds, 1),
    }


def far_pose(line: Mapping[str, Any]) -> bool:
    """Whether a result names a pose of more than `FAR_MM`."""
    return any(
        e["kind"] == "surface_pose" and abs(e["parameters"].get("shift_mm", 0.0)) > FAR_MM for e in line["effects"]
    )


def counted(name: str, of: Sequence[Mapping[str, Any]], key: str) -> str:
    """How many lines have a true value of a key, for the cell of a table."""
    return f"| {name} | {sum(bool(line[key]) for line in of)} of {len(of)} |"
