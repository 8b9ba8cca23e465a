"""The sets of effects beside the answer, on one scale of evidence, each with the reason why it is not the answer.

The search has all sets on one scale: the log evidence of all samples over that of the model as given. Here the verdict
adds why a set that it does not name is refused; of an interrupted search, the sets are those that it had weighed.
`tofmix.reconciliation.verification.aliases` lists what the samples do not separate.
"""

from collections.abc import Iterator
from dataclasses import replace

from tofmix.reconciliation.comparison.panel import Curve
from tofmix.reconciliation.found import Added, Ledger, WeighedSet, set_text
from tofmix.reconciliation.verification.verify import Verified
from tofmix.wording import number

OTHERS = 3
"""Most sets beside the answer and its aliases."""

NAMED = ("explained", "partly_explained")
"""Verdicts with names."""

AT_A_BOUND = "a number is at its bound, where another effect does the same"

_STILL = {
    "bias": "the mean",
    "spread": "the width",
    "skew": "the skew",
    "tails": "the shape of the tails",
    "pattern": "the mean of single pixels",
    "spread_pattern": "the width of single pixels",
    "invalid": "the share of lost samples",
    "common_mode": "the mean of frames",
    "bursts": "the width of frames",
    "trend": "the change in time",
    "memory": "the memory",
    "bridging": "the share of samples between two surfaces",
    "neighbour_correlation": "the correlation of neighbours",
    "discreteness": "the steps of the ranges",
}


def considered(added: Added, verified: Verified, ledger: Ledger) -> tuple[WeighedSet, ...]:
    """The answer, its aliases, and the best others.

    Parameters
    ----------
    added, verified
        The outcome of the search, and its verdict.
    ledger : Ledger
        The sets of the search.

    Returns
    -------
    tuple of WeighedSet
        First the named set, or that without any effect; then sets that the recording cannot separate from it; then at
        most `OTHERS` others, most evidence first. Sets that contain the answer are left out: it explains the recording
        without the rest.
    """
    if ledger.ends():
        return _unfinished(added, verified, ledger)
    if not added.considered:
        return (WeighedSet(names=(), evidence_nats=0.0),)
    best, *others = added.considered
    if verified.verdict in NAMED or not best.names:
        return added.considered
    others = [replace(w, is_alias=False) for w in others if w.names]
    refused = replace(best, why_not=_refusal(added, verified))
    return (WeighedSet(names=(), evidence_nats=0.0), refused, *others[:OTHERS])


def _unfinished(added: Added, verified: Verified, ledger: Ledger) -> tuple[WeighedSet, ...]:
    """The answer of an interrupted search, and the best others that it had weighed."""
    names = tuple(sorted(c.name for c in added.chosen)) if verified.verdict in NAMED else ()
    nats = [w.evidence_nats for w in ledger.sets if w.names == names and w.why_not is None]
    first = WeighedSet(names=names, evidence_nats=nats[-1] if nats else 0.0)
    return (first, *_others_of_search(first, ledger, "but not tried to the end"))


def _others_of_search(first: WeighedSet, ledger: Ledger, more: str) -> Iterator[WeighedSet]:
    """The best sets of the search that do not contain the answer; `more` says why those with more evidence lost."""
    others = [w for w in ledger.best() if not set(w.names) >= set(first.names) or not first.names]
    for other in [w for w in others if w.names != first.names][:OTHERS]:
        yield replace(other, why_not=_by_evidence(other, first, more))


def _by_evidence(other: WeighedSet, first: WeighedSet, more: str) -> str:
    """How much more or less likely one set is than another, in words; `more` ends those of a more likely one."""
    less = first.evidence_nats - other.evidence_nats
    if less >= 0:
        return f"{number(less, ',.0f')} nats less likely"
    return f"{number(-less, ',.0f')} nats more likely, {more}"


def still(curve: Curve) -> str:
    """What still differs, in words."""
    what = _STILL.get(curve.statistic, curve.statistic.replace("_", " "))
    over = "" if curve.axis == "all" else f" over {curve.axis.replace('_', ' ')}"
    return f"{what} still differs{over}"


def _refusal(added: Added, verified: Verified) -> str:
    """Why the effects of a search are not named."""
    found = verified.findings
    said = [f"{set_text([added.chosen[c.number].name])} {c.reason}" for c in verified.against]
    said += ["there are too few samples"] if found.few else []
    said += [f"a smooth function of {found.law} fits better"] if found.law else []
    said += [f"the model's own {found.own.kind} fits better with other numbers"] if found.own is not None else []
    said += [AT_A_BOUND] if found.bound else []
    said += ["another memory than of one frame is left"] if found.echo else []
    said += ["its pattern is a smooth function of place"] if found.shaped else []
    said += [still(curve) for curve in found.open[:1]]
    said += ["ranges change in time" if found.contradicted else "its effects leave the statistics in which they show"]
    return said[0]
