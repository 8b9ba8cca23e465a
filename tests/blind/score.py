"""Score one case: run the command on copies under neutral names, and measure by the bench's own panel what it closed.

Use `score` for one case; `blind.bench` for all. The command sees `model.toml` and `measured.h5` in a folder whose name
says nothing. The gap is measured on a third recording, which nobody else has.
"""

import json
import os
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from blind.camera import Recording
from blind.cases import Built
from blind.judge import judge
from blind.panel import Statistic, compare, gap
from blind.two_samples import two_samples
from blind.write import model_text, read_recording, write_recording

SIMULATE = (sys.executable, "-m", "tofmix", "simulate")
RECONCILE = (sys.executable, "-m", "tofmix", "reconcile")
_LIMIT_S = 1800
_FRESH = 105  # of the simulations that the two-sample tests get
_SEED = 102  # of the true effect's simulations and of the refined one's: both have the same luck
# A recording holds few bursts, so that one simulation comes near another recording or not by luck: more are averaged.
SIMULATIONS = {"interference": 6}


def run(command: Sequence[str]) -> None:
    """Run a command to its end; a RuntimeError with what it said, if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command[:4])}: exit {done.returncode}: {done.stderr.strip()[-400:]}")


def simulate(model: Path, seed: int) -> Recording:
    """What `tofmix simulate` makes of a model file."""
    output = model.with_suffix(f".{seed}.h5")
    run([*SIMULATE, str(model), "-o", str(output), "--seed", str(seed)])
    recording = read_recording(output)
    output.unlink()
    return recording


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What is done with a case."""

    reconcile: tuple[str, ...] | None = RECONCILE
    ceiling: bool = True
    second: bool = True
    small: bool = False
    simulate: Callable[[Path, int], Recording] = simulate


def score(built: Built, work: Path, plan: Plan) -> dict[str, Any]:
    """Score one case in a working folder, which is removed afterwards.

    Returns dict: what JSON can hold: the case, the truth, the panel before, gaps before, after, floor and ceiling, and
      what the reconciliation said.
    """
    folder = work / f"{crc32(built.case.name.encode()) ^ built.seeds[0]:08x}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        return _score(built, folder, plan)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _score(built: Built, folder: Path, plan: Plan) -> dict[str, Any]:
    model = folder / "model.toml"
    model.write_text(model_text(built.device, built.models[0], built.noise), encoding="utf-8")
    third, fourth = built.record(2), built.record(3)
    panel = compare(third, plan.simulate(model, 101))
    out: dict[str, Any] = {
        "case": built.case.name,
        "half": built.case.half,
        "sort": built.case.sort,
        "level": built.case.level,
        "truth": built.truth(),
        "frames": built.device.frames,
        "image": [built.device.rows, built.device.cols],
        "panel": [[s.statistic, s.axis, round(s.distance, 4), round(s.z, 3)] for s in panel],
        "before": gap(panel),
        "floor": gap(compare(third, fourth)),
        "setting": built.case.setting,
    }
    if plan.ceiling and built.truth()["kinds"]:
        true_model = folder / "true.toml"
        text = model_text(built.device, built.models[0], built.noise, effects=true_effects(built, folder))
        true_model.write_text(text, encoding="utf-8")
        panels = _panels(third, true_model, built, plan, seed=_SEED)
        out["ceiling"] = _closed(out["before"], _mean_gap(panels), out["floor"])
        out["ceiling_rest"] = _largest(panels[0])
    if plan.reconcile is not None:
        out |= _reconcile(built, folder, plan, third, (out["before"], out["floor"]))
    refined = folder / "result" / "model.toml"
    out["two_samples"] = {"before": _two_samples(fourth, model, plan)}
    if out.get("named") and "failed" not in out:
        out["two_samples"]["after"] = _two_samples(fourth, refined, plan)
    elif "verdict" in out:
        out["two_samples"]["after"] = out["two_samples"]["before"]  # nothing was added to the model
    return out


def _panels(measured: Recording, model: Path, built: Built, plan: Plan, *, seed: int) -> list[list[Statistic]]:
    """A recording against simulations of a model, as many as the hidden kinds ask for."""
    times = max((SIMULATIONS.get(kind, 1) for kind in built.case.kinds), default=1)
    return [compare(measured, plan.simulate(model, seed + 100 * number)) for number in range(times)]


def _two_samples(measured: Recording, model: Path, plan: Plan) -> dict[str, list[float]]:
    """Value, limit and p of each two-sample test of a fresh recording against a fresh simulation of a model."""
    tests = two_samples(measured, plan.simulate(model, _FRESH))
    return {t.name: [round(t.value, 4), round(t.limit, 4), round(t.p, 4)] for t in tests}


def _mean_gap(panels: Sequence[list[Statistic]]) -> float:
    return float(np.mean([gap(panel) for panel in panels]))


def _largest(panel: list[Statistic]) -> list[list[Any]]:
    worst = sorted(panel, key=lambda s: -s.z)[:3]
    return [[s.statistic, s.axis, round(s.z, 1)] for s in worst]


def _closed(before: float, after: float, floor: float) -> float | None:
    """Share of the gap that is closed; None where there is none to speak of."""
    return None if before - floor < 0.15 else (before - after) / (before - floor)


def true_effects(built: Built, folder: Path) -> list[dict[str, Any]]:
    """The hidden effects as [[effect]] tables; the device's own maps beside the model."""
    maps = built.maps()
    out = []
    for effect in built.truth()["effects"]:
        kind, parameters = effect["kind"], effect["parameters"]
        if kind in maps:
            np.save(folder / f"true_{kind}.npy", maps[kind].astype(np.float32))
            parameters = {"map": f"true_{kind}.npy"}
        out.append({"kind": kind, **parameters})
    return out


def _reconcile(built: Built, folder: Path, plan: Plan, third: Recording, gaps: tuple[float, float]) -> dict[str, Any]:
    variant = crc32(built.case.name.encode()) % (3 if "temperature_drift" in built.case.kinds else 4)
    measured, result = folder / "measured.h5", folder / "result"
    write_recording(measured, built.record(0), built.device, built.noise, variant=variant)
    assert plan.reconcile is not None
    started, used = time.perf_counter(), os.times()
    try:
        run([*plan.reconcile, str(folder / "model.toml"), str(measured), "-o", str(result)])
        said = json.loads((result / "gap.json").read_text(encoding="utf-8"))
    except (RuntimeError, OSError, ValueError, subprocess.TimeoutExpired) as error:
        return {"failed": str(error)[-600:], "seconds": time.perf_counter() - started}
    now = os.times()
    out = judge(said, built, result)
    out["seconds"] = time.perf_counter() - started
    out["cpu_seconds"] = now.children_user + now.children_system - used.children_user - used.children_system
    out["said"] = {"gap": said.get("gap"), "effects": said.get("effects", [])}
    if not out["named"]:
        return out | {"after": gaps[0], "closed": _closed(gaps[0], gaps[0], gaps[1])}
    try:
        out["after"] = _mean_gap(_panels(third, result / "model.toml", built, plan, seed=_SEED))
        out["closed"] = _closed(gaps[0], out["after"], gaps[1])
        if plan.second:
            out["second_scene"] = _second_scene(built, result, plan)
    except RuntimeError as error:
        out["failed"] = str(error)
    return out


def _second_scene(built: Built, result: Path, plan: Plan) -> dict[str, Any]:
    """What the refined effects close on the other scene."""
    refined = tomllib.loads((result / "model.toml").read_text(encoding="utf-8")).get("effect", [])
    gaps = []
    measured = built.record(4)
    for name, effects in (("plain", []), ("refined", refined)):
        model = result / f"second_{name}.toml"
        model.write_text(model_text(built.device, built.models[1], built.noise, effects=effects), encoding="utf-8")
        gaps.append(_mean_gap(_panels(measured, model, built, plan, seed=104)))
    floor = gap(compare(measured, built.record(5)))
    return {"before": gaps[0], "after": gaps[1], "floor": floor, "closed": _closed(gaps[0], gaps[1], floor)}
