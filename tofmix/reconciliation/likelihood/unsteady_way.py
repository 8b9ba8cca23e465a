"""The way of surfaces that move: nothing real moves quite steadily, and noise changes where the way leads.

An effect says that a surface moves steadily. A hand, a drone or a robot speeds up, slows down and shakes, and the times
of frames have errors. So what moves is ahead of its steady way, or behind it, by a part of that way: a random walk in
time beside its straight line, and an independent part of each frame. Sizes of both are small parts of the way, up to
one in twelve, and are integrated out.

A recording that is the scene tells the noise at the ranges that it saw. Beyond them, the noise goes with a power of
range, about 1. If the scene is the first frames of the recording itself, what moves has moved in them too, and its
widths hold this way: its noise at rest is a part of them that is fitted.

References
----------
Rasmussen and Williams, Gaussian Processes for Machine Learning, section 2.7 and equation A.9, for a Gaussian course
beside a law that is fitted, and its inverse.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from tofmix.arrays import FloatArray

PARTS = (0.0, 0.0025, 0.005, 0.01, 0.02, 0.04, 0.08)
"""Standard deviations, as parts of the way, of the walk at its end, and of the part of each frame."""

USUAL_POWER, POWER_SPREAD = 1.0, 0.5
"""Power of range with which noise goes, and its standard deviation: shot noise has 1, light from elsewhere 2."""


class UnsteadyWay(NamedTuple):
    """What is uneven in the way of surfaces that move."""

    ahead_s: FloatArray
    """(frame,), by how much what moves is ahead of its steady way, in times of this way."""

    noise_power: float = 0.0
    """Power of range with which noise goes beyond the ranges of a measured scene."""

    path_mm: FloatArray | None = None
    """(frame,), the way of a typical pixel itself, which then stays as it is at another speed; None: `ahead_s` does."""

    rest: float | None = None
    """Noise of what moves over that of a measured scene whose widths hold its way; None if no scene's do."""

    speed_error: float = 0.0
    """Standard error of the steady speed by what is uneven, as a part of the speed."""

    def ahead_at(self, speed_mm_s: float, time_s: FloatArray) -> FloatArray:
        """`ahead_s` at a speed of a typical pixel."""
        return self.ahead_s if self.path_mm is None else np.asarray(self.path_mm / speed_mm_s - time_s)


class Course(NamedTuple):
    """How far what moves is ahead of its steady way in each frame, by its samples and by the sizes of `PARTS`."""

    nats: float
    """Log density of the samples with the course integrated out, less that about the present course."""

    ahead_mm: FloatArray
    """(frame,), the most likely course."""

    speed_variance: float
    """Variance of the steady speed that the course leaves, (mm/s)^2; 0 if nothing is uneven."""


def course(
    here_mm: FloatArray, slope: FloatArray, information: FloatArray, time_s: FloatArray, way_mm: float
) -> Course:
    """The course by parabolas of the frames' log-likelihoods.

    Parameters
    ----------
    here_mm, slope, information : (frame,) float64
        Present course, mm; slope, 1/mm, and information, 1/mm2, of the log-likelihood of each frame about it.
    time_s : (frame,) float64
        Times of the frames, from that at which the surfaces are where the model has them.
    way_mm : float
        The whole way, above 0.
    """
    told = information > 0
    safe = np.where(told, information, 1.0)
    y = np.where(told, here_mm + slope / safe, 0.0)
    peak = 0.5 * float((slope[told] ** 2 / information[told]).sum())
    knots = np.linspace(0.0, max(float(time_s[-1]), 1e-9), 11)
    hats = np.stack([np.interp(time_s, knots, row) for row in np.eye(knots.size)[1:]], axis=1)
    since, whole = time_s - time_s.mean(), hats.copy()
    hats -= np.outer(since, since @ hats) / max(float(since @ since), 1e-300)  # the steady speed is that of all frames
    root = np.tril(np.ones((knots.size - 1, knots.size - 1))) / math.sqrt(knots.size - 1)  # of the walk's covariance
    walk, whole_walk = hats @ root, whole @ root
    best, nats, prior = (-np.inf, here_mm, 0.0), [], []
    steady = 0.5  # probability that there is no walk, and that no frame has a part of its own
    for jitter in PARTS:
        weight = np.where(told, safe / (1.0 + safe * (jitter * way_mm) ** 2), 0.0)
        plain = float(y @ (weight * y)) + float(np.log1p(information * (jitter * way_mm) ** 2)[told].sum())
        for drift in PARTS:
            own = walk * (drift * way_mm)
            pull = own.T @ (weight * y)
            along, volume = _solved(own.T @ (own * weight[:, None]), pull)
            nats.append(peak - 0.5 * (plain - float(pull @ along) + volume))
            prior.append(
                math.prod(steady if size == 0 else (1.0 - steady) / (len(PARTS) - 1) for size in (jitter, drift))
            )
            if nats[-1] + math.log(prior[-1]) > best[0]:
                mean = own @ along + (jitter * way_mm) ** 2 * weight * (y - own @ along)
                told_of_speed = _told_of_speed(whole_walk * (drift * way_mm), weight, time_s)
                best = (nats[-1] + math.log(prior[-1]), mean, told_of_speed)
    exact = float((information * time_s**2)[told].sum())
    return Course(
        float(logsumexp(nats, b=prior)),
        best[1],
        max(1.0 / best[2] - 1.0 / exact, 0.0) if best[2] > 0 and exact > 0 else 0.0,
    )


def _told_of_speed(walk: FloatArray, weight: FloatArray, time_s: FloatArray) -> float:
    """Information about a steady speed, (s/mm)^2, beside a walk (frame, n): a speed that changes is known less."""
    slow = weight * time_s
    pull = walk.T @ slow
    along, _ = _solved(walk.T @ (walk * weight[:, None]), pull)
    return float(time_s @ slow - pull @ along)


def _solved(gram: FloatArray, pull: FloatArray) -> tuple[FloatArray, float]:
    """(1 + gram)^-1 pull, and the logarithm of the determinant of 1 + gram, of a matrix without negative values."""
    value, axes = np.linalg.eigh(gram)
    value = np.maximum(value, 0.0)
    return np.asarray(axes @ ((axes.T @ pull) / (1.0 + value))), float(np.log1p(value).sum())
