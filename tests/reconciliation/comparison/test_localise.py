"""A planted interval is found, chance is not."""

import numpy as np
import pytest

from tofmix.reconciliation.comparison.compare import Compared, disagreements, localise
from tofmix.reconciliation.comparison.panel import Curve

BINS = 30


def curve(value: np.ndarray, *, statistic: str = "bias", axis: str = "range") -> Curve:
    """A curve with errors of 0.01 in each bin."""
    edges = np.linspace(1000.0, 4000.0, BINS + 1)
    return Curve(
        statistic=statistic,
        axis=axis,
        lower=edges[:-1],
        upper=edges[1:],
        value=value,
        variance=np.full(BINS, 1e-4),
        unit="mm",
        scale_mm=np.full(BINS, 20.0),
    )


def panel(*curves: Curve) -> Compared:
    """A panel of these."""
    return Compared(curves=curves, pattern=np.zeros(4), part=(np.arange(2), np.arange(4)))


def test_planted_interval_is_the_place(rng: np.random.Generator) -> None:
    value = rng.normal(size=BINS) * 0.01
    value[10:14] -= 0.5
    quiet = curve(rng.normal(size=BINS) * 0.01, axis="col")
    (place,) = localise(panel(curve(value), quiet), alpha=0.01)
    assert (place.axis, place.statistic, place.interval) == ("range", "bias", (2000.0, 2400.0))
    assert place.size == pytest.approx(-10.0, abs=0.5)  # half a sigma of 20 mm
    assert place.p_value < 1e-99


def test_noise_alone_has_a_place_at_most_at_the_rate_alpha() -> None:
    rng = np.random.default_rng(4)
    found = [bool(disagreements(panel(curve(rng.normal(size=BINS) * 0.01)), 0.01)) for _ in range(500)]
    assert np.mean(found) < 0.03  # 0.01 is wanted


def test_disagreement_below_the_contracts_limit_is_no_place() -> None:
    tiny = curve(np.full(BINS, 0.019))  # 10 standard errors over all bins, but below 0.02 sigma
    assert tiny.z > 4
    assert localise(panel(tiny), alpha=0.01) == []
