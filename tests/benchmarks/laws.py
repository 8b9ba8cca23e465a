"""`tofmix reconcile` on one law alone, at sizes whose trace is known: how often it is right, and by how much off.

    PYTHONPATH=tests python tests/benchmarks/laws.py --output RESULTS
    PYTHONPATH=tests python tests/benchmarks/laws.py --output RESULTS --draws 20 --law near_return
    PYTHONPATH=tests python tests/benchmarks/laws.py --output RESULTS --summary

Scenes are those of users in turn (`users.cases`), and rooms. An internal reflection and a smooth pattern are so large
that the best set of up to two other kinds, fitted to predictions without noise, explains them worse by 15, 60 or 240
nats (`users.oracle`). A second path of free share and length gives one surface any bias and any noise: those of one
surface are so large that the model without effects is worse by so much, noise by 60, 240 or 960 nats. A near return
has a share of 0.1, 1 or 6 %. Every case is a line of `RESULTS/laws.jsonl`; a case that has a line is not
done again. docs/results/laws.md has the table.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from users.cases import FRAMES, RATE_HZ, Case, _seen, draw, recorded
from users.oracle import _Laws, known
from users.score import alternatives, score

from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.search.name import KINDS
from tofmix.reconciliation.search.search_state import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.excess_noise import ExcessNoise
from tofmix.simulation.effects.internal_reflection import InternalReflection
from tofmix.simulation.effects.smooth_pattern import SmoothPattern
from tofmix.simulation.effects.surface_offset import SurfaceOffset
from tofmix.simulation.model import Model

SEED = 4501
SIZES: Mapping[str, tuple[float, ...]] = {
    "internal_reflection": (15.0, 60.0, 240.0),
    "near_return": (0.001, 0.01, 0.06),
    "excess_noise": (60.0, 240.0, 960.0),  # 1 % more noise is within the tolerance
    "surface_offset": (15.0, 60.0, 240.0),
    "smooth_pattern": (15.0, 60.0, 240.0),
}
UNITS = {
    "internal_reflection": "nats",
    "near_return": "of samples",
    "excess_noise": "nats over no effect",
    "surface_offset": "nats over no effect",
    "smooth_pattern": "nats",
}
SCENES = ("slanted", "two boards", "wall and box", "corner", "steps", "room", "wall", "corridor", "alcove")
NOTHING_MOVED_MM, NOTHING_SHARED = 50.0, 0.1
"""A pose and a second path in the place of the law are never larger."""
_MOST_KINDS = 2  # of a set without the law


def of_scene(scene: str, number: int) -> Case:
    """The first case of this scene from some number on, without effects."""
    rooms = "boards" if scene in ("wall", "slanted", "wall and box", "two boards", "corner", "steps") else "rooms"
    k = 1000 * number
    while (case := draw(SEED, k, rooms)).scene != scene:
        k += 1
    given = replace(case.given, effects=())
    return replace(case, sort="effects", given=given, true=given, hidden=(), stranger=None)


def gain_without(given: Model, hidden: Effect, most: int = _MOST_KINDS) -> float:
    """Nats by which the best set of at most so many other kinds is behind this effect, without noise."""
    laws = _Laws(given)
    loss = laws.losses(laws.seen(replace(given, effects=(hidden,)), slower=1.0))
    others = [k for k in laws.kinds if k != hidden.kind]
    return min(loss(kinds) for size in range(most + 1) for kinds in combinations(others, size))


def of_nats(given: Model, nats: float, make: Callable[[float], Effect], most: int = _MOST_KINDS) -> Effect | None:
    """The effect, by its size, that other sets explain worse by so many nats; None if it were implausibly large."""
    size = 0.1
    for _ in range(4):  # the gain bends for large ones
        size = min(size * float(np.sqrt(nats / max(gain_without(given, make(size), most), 1e-9))), 1e3)
        if not make(size).plausible():
            return None
    return make(size) if abs(gain_without(given, make(size), most) / nats - 1) < 0.2 else None


def reflection(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """An internal reflection of so many nats."""
    range_mm = float(rng.uniform(0, 150))
    return of_nats(given, nats, lambda size: InternalReflection(amplitude=size, range_mm=range_mm))


def sunlit(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """More noise on one of several surfaces, of so many nats over no effect."""
    name = _one_of_several(given, rng)
    if name is None:
        return None
    return of_nats(given, nats, lambda size: ExcessNoise(surface=name, factor=float(np.exp(size))), 0)


def translucent(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """A bias of one of several surfaces, of so many nats over no effect."""
    name = _one_of_several(given, rng)
    return None if name is None else of_nats(given, nats, lambda size: SurfaceOffset(surface=name, offset_mm=size), 0)


def _one_of_several(given: Model, rng: np.random.Generator) -> str | None:
    seen = _seen(given)
    return seen[int(rng.integers(len(seen)))].name if len(seen) > 1 else None


def smooth(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """A smooth pattern of so many nats: of a lens, or of lines."""
    names = (("radial_2_mm",), ("radial_4_mm",), ("across_mm", "down_mm"))[int(rng.integers(3))]
    shares = rng.normal(size=len(names))
    shares /= float(np.hypot.reduce(shares))
    return of_nats(given, nats, lambda size: SmoothPattern(**dict(zip(names, map(float, size * shares), strict=True))))


def near_return(given: Model, share: float, rng: np.random.Generator) -> Effect:  # noqa: ARG001  as the others
    """A near return of this share."""
    return EFFECTS["near_return"](share=share, range_mm=float(rng.uniform(15, 60)), sigma_mm=float(rng.uniform(3, 8)))  # type: ignore[call-arg]


MAKERS: Mapping[str, Callable[[Model, float, np.random.Generator], Effect | None]] = {
    "internal_reflection": reflection,
    "near_return": near_return,
    "excess_noise": sunlit,
    "surface_offset": translucent,
    "smooth_pattern": smooth,
}


def cases(law: str, draws: int) -> Iterator[tuple[str, float, Case]]:
    """Name, size and case, each size `draws` times, over the scenes that can show it."""
    for size in SIZES[law]:
        done, number = 0, 0
        while done < draws and number < 4 * draws:
            scene = SCENES[number % len(SCENES)]
            rng = np.random.default_rng([SEED, number, round(1000 * size)])
            case = of_scene(scene, number)
            effect = MAKERS[law](case.given, size, rng)
            number += 1
            if effect is None:
                continue
            done += 1
            hidden = replace(case, true=replace(case.given, effects=(effect,)), hidden=(effect,))
            yield f"{law} {size:g} {done} {scene}", size, hidden


def judged(name: str, size: float, case: Case, seed: int) -> dict[str, Any]:
    """The outcome of one case."""
    evidence = make_evidence(case.given, recorded(replace(case, seed=seed)), time_s=np.arange(FRAMES) / RATE_HZ)
    start = time.perf_counter()
    gap = reconcile(case.given, evidence, Settings(kinds=KINDS)).as_dict()
    seconds = time.perf_counter() - start
    (hidden,) = case.hidden
    oracle = known(case)
    outcome = score(case, gap, oracle)
    own = next((e for e in gap["effects"] if e["kind"] == hidden.kind), None)
    off = (
        {}
        if own is None
        else {n: (own["parameters"][n] - getattr(hidden, n)) / e for n, e in own["stderr"].items() if e}
    )
    wrong_place = own is not None and own["parameters"].get("surface", "") != getattr(hidden, "surface", "")
    listed = any(hidden.kind in kinds for kinds in alternatives(gap))
    return {
        "name": name,
        "law": hidden.kind,
        "size": size,
        "result": "wrong" if wrong_place else outcome.result,
        "why": "of another surface" if wrong_place else outcome.why,
        "verdict": gap["verdict"],
        "named": sorted(e["kind"] for e in gap["effects"]),
        "listed": listed,
        "hidden": {n: getattr(hidden, n) for n in hidden.parameters()},
        "off": off,
        "effects": gap["effects"],
        "aliases": [a["kinds"] for a in gap["aliases"]],
        "far": far_off(gap),
        "identifiable": oracle.identifiable,
        "seconds": round(seconds, 1),
    }


def far_off(gap: Mapping[str, Any]) -> bool:
    """Whether a pose of more than 50 mm or a second path of more than 0.1 is named."""
    return any(
        abs(e["parameters"].get("shift_mm", 0.0)) > NOTHING_MOVED_MM
        or (e["kind"] == "multipath" and e["parameters"]["share"] > NOTHING_SHARED)
        for e in gap["effects"]
    )


def lines(output: Path) -> list[dict[str, Any]]:
    """What is done."""
    path = output / "laws.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def table(done: list[dict[str, Any]]) -> str:
    """One row a law and size."""
    out = (
        "| law | size | cases | right | wrong | undecided | numbers within two errors | far pose or path | median s |\n"
    )
    out += "|---|---|---|---|---|---|---|---|---|\n"
    for law, sizes in SIZES.items():
        for size in sizes:
            own = [d for d in done if d["law"] == law and d["size"] == size]
            if own:
                count = {r: sum(d["result"] == r for d in own) for r in ("right", "wrong", "open")}
                off = [abs(v) for d in own for v in d["off"].values()]
                within = f"{sum(v < 2 for v in off)} of {len(off)}"
                seconds = float(np.median([d["seconds"] for d in own]))
                out += (
                    f"| `{law}` | {size:g} {UNITS[law]} | {len(own)} | {count['right']} | {count['wrong']} | "
                    f"{count['open']} | {within} | {sum(d['far'] for d in own)} | {seconds:.0f} |\n"
                )
    return out


def main() -> None:
    """Run what is not done yet, and print the table."""
    parser = argparse.ArgumentParser(description="One law alone, at sizes whose trace is known.")
    parser.add_argument("--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--law", choices=list(SIZES), action="append", help="one of the laws; all by default")
    parser.add_argument("--draws", type=int, default=5, help="cases of each size")
    parser.add_argument("--summary", action="store_true", help="only print the table of what is done")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    names = {d["name"] for d in lines(options.output)}
    for law in [] if options.summary else options.law or list(SIZES):
        for number, (name, size, case) in enumerate(cases(law, options.draws)):
            if name in names:
                continue
            line = judged(name, size, case, SEED + number)
            with (options.output / "laws.jsonl").open("a") as file:
                file.write(json.dumps(line) + "\n")
            print(name, line["result"], line["verdict"], line["named"], line["why"], flush=True)
    print(table(lines(options.output)))


if __name__ == "__main__":
    main()
