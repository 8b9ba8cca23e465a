"""`tofmix reconcile` on one law alone, at sizes whose trace is known: how often it is right, and by how much off.

    PYTHONPATH=tests python tests/benchmarks/laws.py --output RESULTS
    PYTHONPATH=tests python tests/benchmarks/laws.py --output RESULTS --draws 20 --law near_return
    PYTHONPATH=tests python tests/benchmarks/laws.py --output RESULTS --summary

Scenes are those of users in turn (`users.cases`), and rooms. An internal reflection is so large that the best set of up
to two other kinds, fitted to predictions without noise, explains it worse by 15, 60 or 240 nats (`users.oracle`); so
are unequal taps and a smooth pattern. For an optional part of a law (a harmonic beside a wiggling of 12 mm, the
saturation of a walk, the second term of a drift, noise by the angle of incidence, one bounce in place of a constant
second path) the law without the part is one of the other kinds. A second path of free share and length gives one
surface any bias and any noise: those of one surface, a pose and a second path are so large that the model without
effects is worse by so much, noise by 60, 240 or 960 nats. A near return has a share of 0.1, 1 or 6 %; the noise of a
beat is 0.3, 1 or 3 typical sigma. Every case is a line of `RESULTS/laws.jsonl`; a case that has a line is not done
again. docs/results/laws.md has the table.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import numpy as np
from users.cases import FRAMES, RATE_HZ, Case, _seen, draw, recorded
from users.oracle import _Laws, known
from users.score import alternatives, numbers_of, score

from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.amplitude_walk import AmplitudeWalk
from tofmix.simulation.effects.bounce import sees
from tofmix.simulation.effects.excess_noise import ExcessNoise
from tofmix.simulation.effects.interference import Interference
from tofmix.simulation.effects.internal_reflection import InternalReflection
from tofmix.simulation.effects.multipath import Multipath
from tofmix.simulation.effects.smooth_pattern import SmoothPattern
from tofmix.simulation.effects.surface_offset import SurfaceOffset
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.effects.tap_mismatch import TapMismatch
from tofmix.simulation.effects.temperature_drift import TemperatureDrift
from tofmix.simulation.effects.wiggling import Wiggling
from tofmix.simulation.exposure import predict
from tofmix.simulation.model import Model

SEED = 4501
_NATS = (15.0, 60.0, 240.0)
SIZES: Mapping[str, tuple[float, ...]] = {
    "internal_reflection": _NATS,
    "near_return": (0.001, 0.01, 0.06),
    "tap_mismatch": _NATS,
    "wiggling, a harmonic": _NATS,
    "amplitude_walk, saturating": _NATS,
    "temperature_drift, two terms": _NATS,
    "excess_noise": (60.0, 240.0, 960.0),  # 1 % more noise is within the tolerance
    "excess_noise, by angle": _NATS,
    "interference, always on": _NATS,
    "interference, in a part": _NATS,
    "excess_noise, in a part": _NATS,
    "interference, beat": (0.3, 1.0, 3.0),
    "surface_offset": _NATS,
    "smooth_pattern": _NATS,
    "surface_pose": _NATS,
    "multipath": _NATS,
    "multipath, one bounce": _NATS,
}
UNITS: Mapping[str, str] = {
    "near_return": "of samples",
    "excess_noise": "nats over no effect",
    "interference, beat": "typical sigma",
    "surface_offset": "nats over no effect",
    "surface_pose": "nats over no effect",
    "multipath": "nats over no effect",
}
"""Units of the sizes; nats over other sets, where there is none."""
PARTS: Mapping[str, str] = {
    "wiggling, a harmonic": "harmonic_8_mm",
    "amplitude_walk, saturating": "saturation_amplitude",
    "temperature_drift, two terms": "amplitude_2_mm",
    "excess_noise, by angle": "angle_exponent",
    "interference, in a part": "spot_across",
    "excess_noise, in a part": "spot_across",
    "interference, beat": "period_frames",
    "multipath, one bounce": "from",
}
"""The parameter that says that the optional part is there."""
SCENES = ("slanted", "two boards", "wall and box", "corner", "steps", "room", "wall", "corridor", "alcove")
NOTHING_MOVED_MM, NOTHING_SHARED = 50.0, 0.1
"""A pose and a second path in the place of the law are never larger."""
_MOST_KINDS = 2  # of a set without the law
_LARGEST = 900.0  # mm or units of amplitude: none is so large


def of_scene(scene: str, number: int) -> Case:
    """The first case of this scene from some number on, without effects."""
    rooms = "boards" if scene in ("wall", "slanted", "wall and box", "two boards", "corner", "steps") else "rooms"
    k = 1000 * number
    while (case := draw(SEED, k, rooms)).scene != scene:
        k += 1
    given = replace(case.given, effects=())
    return replace(case, sort="effects", given=given, true=given, hidden=(), stranger=None)


def gain_without(given: Model, hidden: Effect, *, part: bool = False, most: int = _MOST_KINDS) -> float:
    """Nats by which the best set of at most so many other kinds is behind this effect, without noise.

    With `part`, its own kind without optional parts counts as another kind.
    """
    laws = _Laws(given, optional=not part)
    loss = laws.losses(laws.seen(replace(given, effects=(hidden,)), slower=1.0))
    others = [k for k in laws.kinds if part or k != hidden.kind]
    return min(loss(kinds) for size in range(most + 1) for kinds in combinations(others, size))


def of_nats(
    given: Model, nats: float, make: Callable[[float], Effect], *, part: bool = False, most: int = _MOST_KINDS
) -> Effect | None:
    """The effect, by its size, that other sets explain worse by so many nats; None if it were implausibly large."""
    size = 0.1
    for _ in range(4):  # the gain bends for large ones
        gain = gain_without(given, make(size), part=part, most=most)
        size = min(size * float(np.sqrt(nats / max(gain, 1e-9))), _LARGEST)
        if not make(size).plausible():
            return None
    found = make(size)
    return found if abs(gain_without(given, found, part=part, most=most) / nats - 1) < 0.2 else None


def reflection(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """An internal reflection of so many nats."""
    range_mm = float(rng.uniform(0, 150))
    return of_nats(given, nats, lambda size: InternalReflection(amplitude=size, range_mm=range_mm))


def taps(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """Unequal taps of so many nats."""
    one, two = rng.uniform(-np.pi, np.pi, 2).tolist()

    def of_size(size: float) -> Effect:
        return TapMismatch(amplitude_1_mm=size / 2, phase_1_rad=one, amplitude_2_mm=size, phase_2_rad=two)

    return of_nats(given, nats, of_size)


def harmonic(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """A wiggling of 12 mm, whose harmonic of 8 periods has so many nats."""
    own, further = rng.uniform(-np.pi, np.pi, 2).tolist()

    def of_size(size: float) -> Effect:
        return Wiggling(amplitude_mm=12.0, phase_rad=own, harmonics=((8.0, size, further),))

    return of_nats(given, nats, of_size, part=True)


def saturating(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """A walk whose saturation has so many nats."""
    at = float(rng.uniform(50, 200))

    def of_size(size: float) -> Effect:
        return AmplitudeWalk(scale_mm=size, reference_amplitude=at, exponent=1.0, saturation_amplitude=at)

    return of_nats(given, nats, of_size, part=True)


def two_terms(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """A drift whose second term has so many nats."""
    slow, fast = float(rng.uniform(1.5, 3.0)), float(rng.uniform(0.15, 0.3))

    def of_size(size: float) -> Effect:
        second = {"amplitude_2_mm": -0.6 * size, "time_constant_2_s": fast}
        return TemperatureDrift(amplitude_mm=size, time_constant_s=slow, **second)

    return of_nats(given, nats, of_size, part=True)


def sunlit(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """More noise on one of several surfaces, of so many nats over no effect."""
    name = _one_of_several(given, rng)
    if name is None:
        return None
    return of_nats(given, nats, lambda size: ExcessNoise(surface=name, factor=float(np.exp(size))), most=0)


def by_angle(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:  # noqa: ARG001  as the others
    """Noise that grows with the angle of incidence by so many nats; a plain factor is one of the other sets."""
    most = ExcessNoise.parameters()["angle_exponent"].high
    return of_nats(given, nats, lambda size: ExcessNoise(factor=1.0, angle_exponent=min(size, most)), part=True)


def always(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:  # noqa: ARG001  as the others
    """A second camera that is always on, of so many nats over other sets."""
    return of_nats(given, nats, lambda size: Interference(probability=1.0, sigma_mm=10 * size))


def _spot(rng: np.random.Generator) -> dict[str, float]:
    across, down = rng.uniform(-0.5, 0.5, 2).tolist()
    wide, high = rng.uniform(0.2, 0.6, 2).tolist()
    return {"spot_across": across, "spot_down": down, "spot_radius_across": wide, "spot_radius_down": high}


def always_in_a_part(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """A second camera that is always on and lights a part of the image, by so many nats over laws of all of it."""
    spot: Any = _spot(rng)
    return of_nats(given, nats, lambda size: Interference(probability=1.0, sigma_mm=10 * size, **spot), part=True)


def sunlit_part(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """Light of the sun on a part of the image, of so many nats over laws of the whole image."""
    spot: Any = _spot(rng)
    return of_nats(given, nats, lambda size: ExcessNoise(factor=1 + size, **spot), part=True)


def beat(given: Model, size: float, rng: np.random.Generator) -> Effect:
    """A second camera whose frames beat with ours; its noise is so many typical sigma."""
    typical = float(np.median(predict(given).sigma_mm[0]))
    period, share = float(rng.uniform(10, 50)), float(rng.uniform(0.3, 1.0))
    return Interference(probability=share, sigma_mm=size * typical, period_frames=period)


def bounced(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """Light of one bounce between two surfaces that face each other, of so many nats; a constant share is a rival."""
    seen = _seen(given)
    pairs = [(a, b) for a, b in permutations(seen, 2) if sees(a, b)]
    if not pairs:
        return None
    here, there = pairs[int(rng.integers(len(pairs)))]

    def of_size(size: float) -> Effect:
        return Multipath(surface=here.name, share=min(0.1 * size, 1.0), from_=there.name)

    return of_nats(given, nats, of_size, part=True)


def moved(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """One of several surfaces elsewhere, of so many nats over no effect."""
    name = _one_of_several(given, rng)
    if name is None:
        return None
    return of_nats(given, nats, lambda size: SurfacePose(surface=name, shift_mm=size), most=0)


def second_path(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """A second path of constant share on one of several surfaces, of so many nats over no effect."""
    name, extra_mm = _one_of_several(given, rng), float(rng.uniform(500, 1400))
    if name is None:
        return None

    def of_size(size: float) -> Effect:
        return Multipath(surface=name, share=min(0.1 * size, 1.0), extra_path_mm=extra_mm)

    return of_nats(given, nats, of_size, most=0)


def translucent(given: Model, nats: float, rng: np.random.Generator) -> Effect | None:
    """A bias of one of several surfaces, of so many nats over no effect."""
    name = _one_of_several(given, rng)
    if name is None:
        return None
    return of_nats(given, nats, lambda size: SurfaceOffset(surface=name, offset_mm=size), most=0)


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
    "tap_mismatch": taps,
    "wiggling, a harmonic": harmonic,
    "amplitude_walk, saturating": saturating,
    "temperature_drift, two terms": two_terms,
    "excess_noise": sunlit,
    "excess_noise, by angle": by_angle,
    "interference, always on": always,
    "interference, in a part": always_in_a_part,
    "excess_noise, in a part": sunlit_part,
    "interference, beat": beat,
    "surface_offset": translucent,
    "smooth_pattern": smooth,
    "surface_pose": moved,
    "multipath": second_path,
    "multipath, one bounce": bounced,
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


def judged(law: str, name: str, size: float, case: Case, seed: int) -> dict[str, Any]:
    """The outcome of one case."""
    evidence = make_evidence(case.given, recorded(replace(case, seed=seed)), time_s=np.arange(FRAMES) / RATE_HZ)
    start = time.perf_counter()
    gap = reconcile(case.given, evidence, Settings(kinds=KINDS)).as_dict()
    seconds = time.perf_counter() - start
    (hidden,) = case.hidden
    oracle = known(case)
    outcome = score(case, gap, oracle)
    own = next((e for e in gap["effects"] if e["kind"] == hidden.kind), None)
    off = {}
    if own is not None:
        found = numbers_of(own)
        wanted = as_found(hidden, found)
        off = {n: _off(n, found[n], wanted.get(n, 0.0)) / e for n, e in own["stderr"].items() if e}
    wrong_place = own is not None and own["parameters"].get("surface", "") != getattr(hidden, "surface", "")
    listed = any(hidden.kind in kinds for kinds in alternatives(gap))
    return {
        "name": name,
        "law": law,
        "part": own is not None and law in PARTS and PARTS[law] in {**own["stderr"], **own["parameters"]},
        "size": size,
        "result": "wrong" if wrong_place else outcome.result,
        "why": "of another surface" if wrong_place else outcome.why,
        "verdict": gap["verdict"],
        "named": sorted(e["kind"] for e in gap["effects"]),
        "listed": listed,
        "hidden": hidden.numbers(),
        "off": off,
        "effects": gap["effects"],
        "aliases": [a["kinds"] for a in gap["aliases"]],
        "far": far_off(gap, hidden.kind),
        "identifiable": oracle.identifiable,
        "seconds": round(seconds, 1),
    }


def as_found(hidden: Effect, found: Mapping[str, float]) -> dict[str, float]:
    """The numbers of the hidden effect; those of a walk for the reference amplitude of the found one."""
    if not isinstance(hidden, AmplitudeWalk):
        return hidden.numbers()
    reference = found["reference_amplitude"]
    scale_mm = hidden.scale_mm * (hidden.reference_amplitude / reference) ** hidden.exponent
    return replace(hidden, scale_mm=scale_mm, reference_amplitude=reference).numbers()


def _off(name: str, found: float, wanted: float) -> float:
    return math.remainder(found - wanted, 2 * math.pi) if name.endswith("_rad") else found - wanted


def far_off(gap: Mapping[str, Any], hidden: str) -> bool:
    """Whether a pose of more than 50 mm or a second path of more than 0.1 is named in the place of another kind."""
    return any(
        abs(e["parameters"].get("shift_mm", 0.0)) > NOTHING_MOVED_MM
        or (e["kind"] == "multipath" and e["parameters"]["share"] > NOTHING_SHARED)
        for e in gap["effects"]
        if e["kind"] != hidden
    )


def lines(output: Path) -> list[dict[str, Any]]:
    """What is done."""
    path = output / "laws.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def table(done: list[dict[str, Any]]) -> str:
    """One row a law, in each cell its sizes; wrong names and far ones stand in the last line."""
    out = "| law | sizes | right | part named | numbers within two errors | median s |\n|---|---|---|---|---|---|\n"
    for law, sizes in SIZES.items():
        own = [(size, [d for d in done if d["law"] == law and d["size"] == size]) for size in sizes]
        own = [(size, cases) for size, cases in own if cases]
        if own:
            part = [sum(d["part"] for d in cases) for _, cases in own] if law in PARTS else ["-"]
            columns = (
                [f"{size:g}" for size, _ in own],
                [sum(d["result"] == "right" for d in cases) for _, cases in own],
                part,
                [_within(cases) for _, cases in own],
                [f"{np.median([d['seconds'] for d in cases]):.0f}" for _, cases in own],
            )
            sizes_, *rest = ("; ".join(map(str, column)) for column in columns)
            out += f"| {law} | {sizes_} {UNITS.get(law, 'nats')} | {' | '.join(rest)} |\n"
    counts = {r: sum(d["result"] == r for d in done) for r in ("right", "wrong", "open")}
    return out + f"of {len(done)} cases: {counts}, far {sum(d['far'] for d in done)}\n"


def _within(cases: list[dict[str, Any]]) -> str:
    """Numbers within two of their stated errors, of all."""
    off = [abs(v) for d in cases for v in d["off"].values()]
    return f"{sum(v < 2 for v in off)} of {len(off)}"


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
            line = judged(law, name, size, case, SEED + number)
            with (options.output / "laws.jsonl").open("a") as file:
                file.write(json.dumps(line) + "\n")
            print(name, line["result"], line["verdict"], line["named"], line["why"], flush=True)
    print(table(lines(options.output)))


if __name__ == "__main__":
    main()
