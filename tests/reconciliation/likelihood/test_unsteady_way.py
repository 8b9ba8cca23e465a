"""The unsteady way of what moves, against dense Gaussian densities."""

import numpy as np
import pytest
from scipy.special import logsumexp

from tofmix.reconciliation.likelihood.unsteady_way import PARTS, course

FRAMES, WAY_MM = 30, 1000.0
TIME_S = 0.4 + np.arange(FRAMES) / 15.0


def _dense(y: np.ndarray, information: np.ndarray) -> float:
    """Log density of a course by each frame's own samples over its top, all sizes integrated out."""
    knots = np.linspace(0.0, TIME_S[-1], 11)
    hats = np.stack([np.interp(TIME_S, knots, row) for row in np.eye(11)[1:]], axis=1)
    since = TIME_S - TIME_S.mean()
    hats -= np.outer(since, since @ hats) / (since @ since)
    steps = np.minimum.outer(np.arange(1, 11), np.arange(1, 11)) / 10.0
    nats, share = [], []
    for jitter in PARTS:
        for drift in PARTS:
            course_variance = (jitter * WAY_MM) ** 2 * np.eye(FRAMES) + (drift * WAY_MM) ** 2 * hats @ steps @ hats.T
            whole = course_variance + np.diag(1.0 / information)
            volume = np.linalg.slogdet(whole)[1] + np.log(information).sum()
            nats.append(-0.5 * (y @ np.linalg.solve(whole, y) + volume))
            share.append(np.prod([0.5 if size == 0 else 0.5 / (len(PARTS) - 1) for size in (jitter, drift)]))
    return float(logsumexp(nats, b=share))


def test_course_has_the_density_of_a_dense_gaussian_with_all_sizes_integrated_out() -> None:
    rng = np.random.default_rng(3)
    information = rng.uniform(0.01, 0.2, FRAMES)
    slope, here = rng.normal(0.0, 1.0, FRAMES), rng.normal(0.0, 15.0, FRAMES)
    found = course(here, slope, information, TIME_S, WAY_MM)
    top = 0.5 * float((slope**2 / information).sum())
    assert found.nats == pytest.approx(top + _dense(here + slope / information, information), abs=1e-6)


def test_course_follows_what_frames_show_and_widens_the_error_of_the_speed() -> None:
    bent = 60.0 * ((TIME_S - TIME_S.mean()) ** 2 - np.var(TIME_S)) / np.var(TIME_S)
    information = np.full(FRAMES, 0.1)
    found = course(bent, np.zeros(FRAMES), information, TIME_S, WAY_MM)
    np.testing.assert_allclose(found.ahead_mm, bent, atol=8.0)
    assert found.speed_variance > 25.0  # (mm/s)^2; samples alone tell the speed to 0.5 mm/s


def test_steady_way_stays_steady_and_its_speed_is_known_as_well_as_samples_tell() -> None:
    noise = np.random.default_rng(4).normal(0.0, 0.1**-0.5, FRAMES)
    found = course(np.zeros(FRAMES), 0.1 * noise, np.full(FRAMES, 0.1), TIME_S, WAY_MM)
    assert np.abs(found.ahead_mm).max() < 3.0
    assert found.speed_variance < 1.0
