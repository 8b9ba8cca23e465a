"""What lost samples say about the layers of an image."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import binom

from tofmix.lost_samples import Losses, learn_losses

SHAPE = (30, 40)
BOX = (slice(5, 20), slice(10, 25))


def lost_shares(share: float, in_box: float, frames: int, seed: int = 1) -> NDArray[np.float32]:
    """Share of lost frames of each pixel: by chance, with another share in a box."""
    shares = np.full(SHAPE, share)
    shares[BOX] = in_box
    return np.asarray((np.random.default_rng(seed).random((frames, *SHAPE)) < shares).mean(axis=0), dtype=np.float32)


def outside(values: NDArray[np.float64]) -> NDArray[np.float64]:
    box = np.zeros(SHAPE, bool)
    box[BOX] = True
    return values[~box]


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6])
@pytest.mark.parametrize("frames", [10, 25, 100])
def test_loss_of_all_pixels_is_learnt_and_leaves_layers_sure(share: float, frames: int) -> None:
    lost = lost_shares(share, share, frames)
    losses = learn_losses(lost, frames)
    assert losses.common == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / (frames * lost.size)))
    assert losses.by_chance > 0.98
    assert np.quantile(losses.certainty(lost), 0.01) > 0.94
    assert losses.lost_share(lost).mean() < 0.005


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_pixels_of_a_dark_box_are_unsure_and_others_are_not(share: float) -> None:
    lost = lost_shares(share, 0.95, 100)
    losses = learn_losses(lost, 100)
    assert losses.common == pytest.approx(share, abs=0.02)
    assert losses.certainty(lost)[BOX].max() < 0.3
    assert losses.lost_share(lost)[BOX].min() > 0.7
    assert np.quantile(outside(losses.certainty(lost)), 0.01) > 0.999
    assert losses.is_at_limit(lost)[BOX].all()
    assert outside(losses.is_at_limit(lost).astype(float)).max() == 0


def test_wall_of_most_samples_stays_sure_where_the_rest_is_lost() -> None:
    lost = np.zeros(SHAPE, np.float32)
    lost[BOX] = 0.3
    assert learn_losses(lost, 100).certainty(lost)[BOX].min() > 0.9999


def test_certainty_is_the_integral_over_the_valid_share() -> None:
    losses = Losses(frames=20, common=0.2, by_chance=0.7)
    for valid in range(21):

        def likelihood(q: float, valid: int = valid) -> float:
            return float(binom.pmf(valid, 20, q))

        own = 0.3 * quad(likelihood, 0.0, 0.8)[0] / 0.8
        limit = 0.3 * quad(likelihood, 0.0, 0.4)[0] / 0.8
        chance = 0.7 * float(binom.pmf(valid, 20, 0.8))
        back = min(1.0, valid / 20 / 0.8)
        expected = 1.0 - limit / (own + chance) * (1.0 - back)
        assert losses.certainty([1.0 - valid / 20])[0] == pytest.approx(expected, rel=1e-6)


def test_probabilities_without_loss_keep_their_bits() -> None:
    probability = np.random.default_rng(2).random((*SHAPE, 3)).astype(np.float32)
    lost = np.zeros(SHAPE, np.float32)
    assert learn_losses(lost, 30).weighed(probability, lost).tobytes() == probability.tobytes()
    lost[3, 4] = 0.9
    weighed = learn_losses(lost, 30).weighed(probability, lost)
    same = np.ones(SHAPE, bool)
    same[3, 4] = False
    assert weighed[same].tobytes() == probability[same].tobytes()
    assert (weighed[3, 4] < 0.2 * probability[3, 4]).all()


def test_pixels_that_are_always_masked_do_not_make_others_unsure() -> None:
    lost = lost_shares(0.1, 1.0, 50)
    losses = learn_losses(lost, 50)
    assert losses.common == pytest.approx(0.1, abs=0.01)
    assert np.quantile(outside(losses.certainty(lost)), 0.001) > 0.999
    nothing = np.ones(SHAPE, np.float32)
    assert learn_losses(nothing, 50).is_at_limit(nothing).all()


def test_pixels_that_differ_in_brightness_lose_by_chance() -> None:
    """Single photons: pixels have 8 to 600 of them, and none has an obstacle."""
    rng = np.random.default_rng(7)
    photons = np.clip(rng.gamma(2.5, 50.0, SHAPE), 8, 600).astype(int)
    lost = 1.0 - photons / photons.max()
    losses = learn_losses(lost, int(photons.max()))
    assert losses.by_chance > 0.6
    assert np.quantile(losses.certainty(lost), 0.25) > 0.75
    assert np.median(losses.certainty(lost)) > 0.99
