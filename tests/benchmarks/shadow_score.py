"""Whether held-out blocks name what users' scenes hide, without a search: the table of docs/results/reconcile-real.md.

    PYTHONPATH=tests python tests/benchmarks/shadow_score.py [--cases 240] [--seed 20261124]

Of each case of `tests/benchmarks/user_scenes.py` whose effects move or widen samples, or are in the model: whether the
truth is beaten by another set, and whether names are earned where nothing or no effect is hidden.
"""

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from users.cases import FRAMES, RATE_HZ, Case, draw, recorded
from users.oracle import known
from users.shadow import Scored, Shadow, beats

from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.search.columns import ColumnMaker, Term, summed_up, terms
from tofmix.reconciliation.search.name import KINDS
from tofmix.reconciliation.search.search_state import Settings
from tofmix.reconciliation.search.summaries import summaries
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.motion import Motion
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.search import Coefficient
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.effects.temperature_drift import TemperatureDrift

SEED = 20261124
IN_THE_MODEL = ("outliers", "temporal_correlation", "quantisation", "pixel_crosstalk")
"""Kinds that summaries do not tell of, which the model is given."""

SEEN = ("split", "ripple", "noisy part")
"""Strangers that move or widen samples by a law."""


def judged(case: Case) -> Iterator[tuple[str, bool, str]]:
    """What is asked of a case, whether it holds, and what beats the truth; nothing where the score cannot see it."""
    own = [e for e in case.hidden if not summed_up(e.kind)]
    if any(e.kind not in IN_THE_MODEL for e in own) or (case.stranger is not None and case.stranger.name not in SEEN):
        return
    given = replace(case.given, effects=(*case.given.effects, *own))
    evidence = make_evidence(given, recorded(case), time_s=np.arange(FRAMES) / RATE_HZ)
    likelihood = joint_likelihood(((given, evidence),))
    state = likelihood.start()
    everything = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    (summary,) = summaries(likelihood, state, everything)
    exact = [_exact(ColumnMaker(likelihood, state, [summary]), e) for e in case.hidden if summed_up(e.kind)]
    every = terms(likelihood, state, [summary], KINDS)
    shadow = Shadow(summary, every, Settings(kinds=KINDS).tolerance, exact)
    oracle = known(case) if case.hidden else None
    traces = (
        frozenset()
        if oracle is None
        else frozenset(
            (e.kind, getattr(e, "surface", "")) for e in case.hidden if summed_up(e.kind) and e.kind in oracle.traces
        )
    )
    found, count = shadow.finalists([traces])
    nothing = next(s for s in found if not s.names and not s.laws)
    if oracle is None:
        named = [s for s in found if s.names and not s.laws]
        if case.stranger is None:
            best = max(named, key=lambda s: s.total)
            yield "a model that is right or nearly earns no name", not beats(best, nothing, count), _said(best)
        else:
            best, law = (max(some, key=lambda s: s.total) for some in (named, [s for s in found if s.laws]))
            yield "the best set of a stranger loses to a law", beats(law, best, count), _said(best)
        return
    truth = next(s for s in found if s.names == traces and not s.laws)
    beaten = [s for s in found if beats(s, truth, count)]
    sort = "the truth leads or ties" + ("" if oracle.identifiable else ", where it cannot be known")
    yield sort, not beaten, _said(max(beaten, key=lambda s: s.total)) if beaten else ""
    straight = shadow.scored([t for t in exact if t.name in traces])
    yield f"{sort}, with its laws exact", not [s for s in found if beats(s, straight, count)], ""
    if oracle.identifiable:
        others = [s for s in found if not s.laws and not s.names >= truth.names]
        yield "all sets without the truth are beaten", all(beats(truth, s, count) for s in others), ""


def _exact(make: ColumnMaker, effect: Effect) -> Term:
    """A hidden effect as one column, of which about one is in the recording."""
    one = Coefficient(effect=effect, size=1.0, spread=1.0)
    if isinstance(effect, TemperatureDrift):
        tau_s = effect.time_constant_s
        constant = RangeOffset(offset_mm=effect.amplitude_mm)
        one = Coefficient(effect=constant, size=1.0, spread=1.0, course=lambda t: np.asarray(-np.expm1(-t / tau_s)))
    elif isinstance(effect, Motion):
        moved = SurfacePose(surface=effect.surface, shift_mm=effect.velocity_mm_s)
        one = Coefficient(effect=moved, size=1.0, spread=1.0, course=lambda t: t)
    column = make.column(one)
    return Term(kind=effect.kind, surface=getattr(effect, "surface", ""), columns=(column,), make=lambda _: effect)


def _said(scored: Scored) -> str:
    return " + ".join([*sorted(" ".join(n).strip() for n in scored.names), *scored.laws]) or "nothing"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--cases", type=int, default=240)
    options = parser.parse_args(arguments)
    total, held = Counter[str](), Counter[str]()
    for number in range(options.cases):
        case = draw(options.seed, number)
        for asked, holds, instead in judged(case):
            total[asked] += 1
            held[asked] += holds
            if not holds and instead:
                print(f"{case.name}: {asked}: {instead}", flush=True)
    print("| asked | cases | holds | share |\n|---|---|---|---|")
    for asked, count in sorted(total.items()):
        print(f"| {asked} | {count} | {held[asked]} | {held[asked] / count:.3f} |")


if __name__ == "__main__":
    main()
