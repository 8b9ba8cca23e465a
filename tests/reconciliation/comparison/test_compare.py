"""What is planted on one axis is told of that axis first, although it shows on others and in higher orders too."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from tofmix.arrays import Float32Array, FloatArray
from tofmix.reconciliation.comparison.compare import Scored, gain, information
from tofmix.reconciliation.comparison.panel import Axis

FRAMES, ROWS, COLS = 80, 16, 20
ROW, COL = np.divmod(np.arange(ROWS * COLS), COLS)
SIGMA = np.linspace(5.0, 15.0, ROWS * COLS)[np.random.default_rng(4).permutation(ROWS * COLS)]


def scored(z: FloatArray) -> Scored:
    """Scores of an image whose axes are its rows, its columns, and all of it."""
    values: Float32Array = z.astype(np.float32)
    bins = {"all": np.zeros_like(ROW), "row": ROW, "col": COL}
    axes = tuple(
        Axis(name=name, unit="1", bin=b, lower=np.arange(b.max() + 1.0), upper=np.arange(b.max() + 1.0) + 1)
        for name, b in bins.items()
    )
    return Scored(
        z=values,
        ok=np.isfinite(values),
        sigma=SIGMA,
        axes=axes,
        pixels=np.arange(ROWS * COLS),
        image=(ROWS, COLS),
        frames=np.arange(FRAMES),
    )


def planted(name: str, rng: np.random.Generator) -> FloatArray:
    """Scores with a planted change."""
    z: FloatArray = rng.normal(size=(FRAMES, ROWS * COLS))
    now = np.arange(FRAMES)[:, None]
    more: dict[str, FloatArray] = {
        "common_mode of frame": z + 10.0 * rng.normal(size=(FRAMES, 1)) / SIGMA,
        "common_mode of row": z + 0.4 * rng.normal(size=(FRAMES, ROWS))[:, ROW],
        "bias of row": z + np.linspace(-2, 2, ROWS)[ROW],
        "bias of all": z + 10.0 / SIGMA,
        "spread of col": z * np.linspace(0.7, 1.4, COLS)[COL],
        "spread of time": z * (1 + 0.6 * now / FRAMES),
        "spread of all": z * 1.3,
        "tails of all": np.clip(rng.standard_t(5, size=z.shape) / np.sqrt(5 / 3), -4, 4),  # as scores are
        "pattern of all": z + rng.normal(size=ROWS * COLS),
    }
    return more[name]


@pytest.mark.parametrize(
    "name",
    [
        "common_mode of frame",
        "common_mode of row",
        "bias of row",
        "bias of all",
        "spread of col",
        "spread of time",
        "spread of all",
        "tails of all",
        "pattern of all",
    ],
)
def test_planted_change_is_ranked_first_on_its_axis(name: str, rng: np.random.Generator) -> None:
    told = information(scored(planted(name, rng)))
    statistic, axis = max(told, key=lambda key: told[key])
    assert f"{statistic} of {axis}" == name


def test_noise_alone_has_small_gains(rng: np.random.Generator) -> None:
    assert max(information(scored(rng.normal(size=(FRAMES, ROWS * COLS)))).values()) < 12  # of 26 gains


def test_gain_is_the_largest_over_all_variances(rng: np.random.Generator) -> None:
    value = 2.0 * rng.normal(size=30)

    def less(extra: float) -> float:
        return float((norm.logpdf(value) - norm.logpdf(value, scale=np.sqrt(1 + extra))).sum())

    best = minimize_scalar(less, bounds=(0, 50), method="bounded")
    assert gain(float((value**2).sum()), value.size) == pytest.approx(-float(best.fun), rel=1e-4)
    assert gain(20.0, 30) == 0.0
