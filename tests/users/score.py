"""Right, wrong or open: what `reconcile` says of a case, held against what can be known of it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from users.cases import Case
from users.oracle import Known

_ERRORS, _SHARE = 3.0, 0.05
_MOST = 4  # alternatives that may be listed
_PRECISION = 0.5
_AND = " + "
_NOTHING = "no effect"


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """The outcome of a case."""

    result: str
    """``right``, ``wrong`` or ``open``."""
    why: str = ""
    """What is not right."""


def score(case: Case, gap: Mapping[str, Any], known: Known | None) -> Score:
    """Score what `gap.json` says.

    Right: the kinds that leave a trace, with parameters within 3 standard errors or 5 %; where several sets explain the
    case, one of them, with the truth among at most four alternatives of which half are explanations indeed; of a case
    without effects, `agree`; of a stranger, no name. Wrong: a name that no explanation of the case has. Open: the rest.

    `case`: the case.
    `gap`: as `gap.json` holds it.
    `known`: what the oracle says; None for a case without effects.
    """
    named = frozenset(e["kind"] for e in gap["effects"])
    if known is None:
        wanted = "unexplained" if case.sort == "stranger" else "agree"
        silent = Score(result="right") if gap["verdict"] == wanted else Score(result="open", why=gap["verdict"])
        return Score(result="wrong", why=f"named {_AND.join(sorted(named))}") if named else silent
    truth = [frozenset(known.traces), frozenset(e.kind for e in case.hidden)]
    explanations = [*truth, *(frozenset(a) for a in known.aliases)]
    if not known.traces:
        return _of_no_trace(gap, named, explanations)
    false = named - frozenset().union(*explanations)
    if false:
        return Score(result="wrong", why=f"named {_AND.join(sorted(false))}")
    why = _missing(case, gap, named, (truth, explanations))
    return Score(result="open", why=why) if why else Score(result="right")


def _missing(
    case: Case,
    gap: Mapping[str, Any],
    named: frozenset[str],
    sets: tuple[Sequence[frozenset[str]], Sequence[frozenset[str]]],
) -> str:
    """Of what has no false name: what is missing for it to be right; empty if nothing is."""
    truth, explanations = sets
    if gap["verdict"] not in ("explained", "partly_explained"):
        return str(gap["verdict"])
    if named in truth:
        off = _off(case, gap["effects"])
        return f"numbers: {off}" if off else ""
    listed = alternatives(gap)
    if not any(t in listed for t in truth):
        return f"named {_AND.join(sorted(named))}"
    good = sum(one in explanations for one in listed) / len(listed)
    few = len(listed) <= _MOST and good >= _PRECISION
    return "" if few else f"{len(listed)} alternatives, {100 * good:.0f} % of them explanations"


def _of_no_trace(gap: Mapping[str, Any], named: frozenset[str], explanations: Sequence[frozenset[str]]) -> Score:
    if gap["verdict"] == "agree" or any(named and named <= e for e in explanations):
        return Score(result="right")
    return Score(result="wrong" if named else "open", why=_AND.join(sorted(named)) or gap["verdict"])


def alternatives(gap: Mapping[str, Any]) -> list[frozenset[str]]:
    """What was named, and each set of kinds that is said not to be told apart from it."""
    named = frozenset(e["kind"] for e in gap["effects"])
    out = [named]
    for alias in gap["aliases"]:
        first, *others = (_kinds(kinds) for kinds in alias["kinds"])
        out += [frozenset((named - first) | other) for other in others]
    return list(dict.fromkeys(out))


def _kinds(label: str) -> frozenset[str]:
    kinds = (part.split(' "')[0] for part in label.split(_AND))
    return frozenset(kind for kind in kinds if kind != _NOTHING)


def numbers_of(named: Mapping[str, Any]) -> dict[str, float]:
    """The numbers of a named effect by name, those of further sines among them."""
    values = {n: float(v) for n, v in named["parameters"].items() if isinstance(v, int | float)}
    for periods, size_mm, phase_rad in named["parameters"].get("harmonics", ()):
        values |= {f"harmonic_{periods:g}_mm": size_mm, f"harmonic_{periods:g}_rad": phase_rad}
    return values


def _off(case: Case, effects: Iterable[Mapping[str, Any]]) -> str:
    """Numbers that are neither within 3 standard errors of the truth nor within 5 %."""
    off = []
    for found, true in product(effects, case.hidden):
        if found["kind"] != true.kind or found["parameters"].get("surface", "") != getattr(true, "surface", ""):
            continue
        if true.kind in (
            "amplitude_walk",
            "smooth_pattern",
            "fixed_pattern",
            "interference",
        ):  # other numbers may be the same curve
            continue
        values, truth = numbers_of(found), true.numbers()
        for name, error in found["stderr"].items():
            if name.endswith("_rad") and name not in truth:  # of a sine that is not there: its size counts
                continue
            wanted, value = truth.get(name, 0.0), values[name]
            away = abs(value - wanted)
            if name.endswith("_rad"):
                away = abs((away + math.pi) % (2 * math.pi) - math.pi)
            if away > max(_ERRORS * error, _SHARE * abs(wanted)):
                off.append(f"{true.kind} {name} {value:.4g} for {wanted:.4g}")
    return "; ".join(off)
