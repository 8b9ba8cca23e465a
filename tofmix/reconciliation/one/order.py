"""The order in which the effects of a set act: within a level that of their list, so that it is a part of the model."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.recordings import SearchTask
from tofmix.reconciliation.one.tenths import observed

_SAME_NATS = 0.1  # change of the samples' log-likelihood below which two orders of effects predict the same


def in_best_order(s: FittedSet) -> FittedSet:
    """The set with its laws in the order of the highest score at the start.

    Effects of one level act in the order of their list, such as a lens that dims a reflection or one behind which the
    reflection is. Only orders that predict something else are begun.
    """
    level = [law.kind.level for law in s.laws]
    if len(set(level)) == len(level):
        return s
    begun, orders = [(s, _predicted(s))], {tuple(sorted(range(len(level)), key=lambda k: level[k]))}
    for order in permutations(range(len(level))):
        acting = tuple(sorted(order, key=lambda k: level[k]))
        if acting in orders:
            continue
        orders.add(acting)
        other = _in_order(s, acting)
        predicted = _predicted(other)
        if all(_change_nats(s.task, predicted, known) > _SAME_NATS for _, known in begun):
            begun.append((other, predicted))
    return s if len(begun) == 1 else max((one for one, _ in begun), key=lambda one: one.at_start)


def _in_order(s: FittedSet, order: Sequence[int]) -> FittedSet:
    """The set, not begun, with its laws in another order."""
    numbers = np.split(np.arange(s.x.size), np.cumsum([law.size for law in s.laws]))
    at = np.concatenate([numbers[k] for k in order])
    hessian = None if s.hessian is None else s.hessian[np.ix_(at, at)]
    return replace(s, laws=tuple(s.laws[k] for k in order), x=s.x[at], hessian=hessian, started=None, refused="")


def _predicted(s: FittedSet) -> tuple[FloatArray, FloatArray, float]:
    """Mean, mm, and log width (tenth, recording, pixel) of main surfaces, and the log density of side information."""
    state, like = s.state(), s.task.likelihood
    return *observed(s.task, like.mixture(state)), like.side_log_density(state)


def _change_nats(
    task: SearchTask, a: tuple[FloatArray, FloatArray, float], b: tuple[FloatArray, FloatArray, float]
) -> float:
    """By how much samples of one prediction are less likely under another one, nats."""
    by_sample = 0.5 * ((a[0] - b[0]) ** 2 * np.exp(-2 * a[1])) + (a[1] - b[1]) ** 2
    frames = np.zeros(by_sample.shape[:2])
    for number, recording in enumerate(task.recordings):
        frames[: len(recording.tenths), number] = [own.size for own in recording.tenths]
    return float(np.nansum(frames[..., None] * by_sample)) + abs(a[2] - b[2])
