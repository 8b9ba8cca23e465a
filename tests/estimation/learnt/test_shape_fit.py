"""The shape of the error from histograms: a known one is recovered, background taken off; few errors are Gaussian."""

import numpy as np
import pytest
from scipy import stats
from support.learnt_pixels import KNOWN

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.shape_fit import CENTRES, REACH, STEP, fit_shape, histogram

AT = np.linspace(-6.0, 6.0, 121)


def _folds(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    return histogram(z[::2]), histogram(z[1::2])


def test_histogram_counts_errors_about_its_centres(rng: np.random.Generator) -> None:
    z = rng.normal(0.0, 3.0, 5000)
    counts = histogram(z)
    assert counts.sum() == (np.abs(z) < REACH + 0.5 * STEP).sum()
    for centre, count in zip(CENTRES[::17], counts[::17], strict=True):
        assert count == (np.abs(z - centre) <= 0.5 * STEP).sum()
    np.testing.assert_allclose(histogram(z, np.full(z.shape, 0.5)), 0.5 * counts)


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("background", [0.0, 0.2])
def test_known_shape_is_recovered(name: str, background: float, rng: np.random.Generator) -> None:
    z = KNOWN[name].draw(rng, (40000,))
    spread = rng.uniform(-REACH, REACH, 40000)
    found = fit_shape(_folds(np.where(rng.random(40000) < background, spread, z)))
    assert found is not None
    # Sampling alone moves a distribution function by 0.0025 (one standard error at the median).
    assert np.abs(found.cdf(AT) - KNOWN[name].cdf(AT)).max() < 0.015
    at = AT[np.abs(AT) > 0.3]  # a corner at 0 is rounded
    assert np.abs(found.pdf(at) - KNOWN[name].pdf(at)).max() < 0.03
    low, middle, high = found.quantile(stats.norm.cdf([-1.0, 0.0, 1.0]))
    assert (middle, high - low) == (pytest.approx(0.0, abs=0.01), pytest.approx(2.0, abs=0.02))


@pytest.mark.parametrize(("name", "skewness"), [("gaussian", 0.0), ("skewed", 1.0), ("laplace", 0.0)])
def test_skewness_is_recovered_with_its_sign(name: str, skewness: float, rng: np.random.Generator) -> None:
    z = KNOWN[name].draw(rng, (40000,))
    for sign in (1.0, -1.0):
        found = fit_shape(_folds(sign * z))
        assert found is not None
        assert found.moments()[2] == pytest.approx(sign * skewness, abs=0.15)


def test_tails_fall_and_hold_what_was_seen(rng: np.random.Generator) -> None:
    found = fit_shape(_folds(KNOWN["student"].draw(rng, (40000,))))
    assert found is not None
    peak = int(np.argmax(found.density))
    assert (np.diff(found.density[peak:]) <= 1e-9).all()
    assert (np.diff(found.density[: peak + 1]) >= -1e-9).all()
    for chance in (0.001, 0.999):
        true = (KNOWN["student"].law.ppf(chance) - KNOWN["student"].middle) / KNOWN["student"].half
        assert found.quantile(chance) == pytest.approx(true, rel=0.15)


def test_no_errors_are_no_shape() -> None:
    empty = np.zeros(len(CENTRES))
    assert fit_shape((empty, empty)) is None
    assert fit_shape((histogram(np.linspace(-1.0, 1.0, 50)), empty)) is None
