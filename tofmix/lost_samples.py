"""Lost samples: what a pixel's frames without a valid sample say about its layers, and about the space along its beam.

A sample is lost because its light is too dark or saturates the pixel, because nothing is in range, because the camera
drops mixed samples, or by chance. Nothing in the recording says which. So a lost sample says that its light came from
an unknown place. Of n frames, m have a valid sample:

- By chance, as all pixels do: with dropped frames each loses the same share, and with single photons each loses by its
  brightness. The valid share is of a beta distribution with one peak, whose mean is 1 - common; without spread m is
  binomial. Such losses say nothing about the scene, and a layer is as sure as the valid samples make it.
- A loss of its own. A sample is valid with an unknown share q, uniform between 0 and 1 - common. If q is above the
  middle, the pixel's light is enough: a sample is valid more often than not, and is of a surface in the beam. Else the
  light is at the limit of the camera. The few samples that pass are of a surface in the beam, or of light from
  elsewhere (of neighbours, scattered in the lens). A layer then is as sure as else times the share of the light that
  came back.

The beta distribution and the share of the pixels without a loss of their own are learnt from the image, by maximum
likelihood. Integrals over q are regularised incomplete beta functions: that of the binomial probability of m up to q is
I_q(m + 1, n - m + 1) / (n + 1).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betainc, betaln, gammaln, xlog1py, xlogy

from tofmix.arrays import BoolArray, FloatArray

_NARROWNESS = (1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 1e3, math.inf)  # widths of the beta distribution that are tried


@dataclass(frozen=True, slots=True, kw_only=True)
class Losses:
    """Losses of the pixels of an image.

    Parameters
    ----------
    frames : int
        Frames of the window, n.
    common : float
        Mean share of the samples that pixels lose by chance, in [0, 1).
    by_chance : float
        Share of the pixels without a loss of their own, in (0, 1).
    concentration : float
        Sum of both parameters of the beta distribution; infinite where all pixels lose the same share.
    """

    frames: int
    common: float
    by_chance: float
    concentration: float = math.inf

    def returned_share(self, invalid_share: ArrayLike) -> FloatArray:
        """Share (...) of the light that came back, of the light that a pixel can give.

        Exactly 1 for a pixel that loses no more than the common share; a share of frames that is NaN counts as 0.
        """
        return np.asarray(np.minimum((1.0 - _known(invalid_share)) / (1.0 - self.common), 1.0))

    def own(self, invalid_share: ArrayLike) -> FloatArray:
        """Probability (...) that pixels have a loss of their own, in [0, 1]."""
        return self._states(invalid_share)[0]

    def at_limit(self, invalid_share: ArrayLike) -> FloatArray:
        """Probability (...) that the light of pixels is at the limit of the camera, in [0, 1]."""
        return self._states(invalid_share)[1]

    def is_at_limit(self, invalid_share: ArrayLike) -> BoolArray:
        """Whether the light of pixels (...) is more probably at the limit of the camera than not."""
        return np.asarray((self.at_limit(invalid_share) > 0.5) | (_known(invalid_share) >= 1.0))  # noqa: PLR2004

    def lost_share(self, invalid_share: ArrayLike) -> FloatArray:
        """Expected share (...) of the light of pixels that a thing in the scene took, in [0, 1]."""
        return np.asarray(self.own(invalid_share) * (1.0 - self.returned_share(invalid_share)))

    def certainty(self, invalid_share: ArrayLike) -> FloatArray:
        """Factor (...) of the probability of the layers of pixels, in [0, 1].

        Exactly 1 for a pixel that loses no more than the common share.
        """
        return np.asarray(1.0 - self.at_limit(invalid_share) * (1.0 - self.returned_share(invalid_share)))

    def weighed(self, probability: NDArray[np.float32], invalid_share: NDArray[np.float32]) -> NDArray[np.float32]:
        """Probabilities of layers, with the lost samples of their pixels.

        Parameters
        ----------
        probability : (..., layer) float32
            Of the valid samples; NaN where there is no layer.
        invalid_share : (...) float32
            Share of the frames without a valid sample.

        Returns
        -------
        (..., layer) float32
            The same bits for a pixel that loses no more than the common share.
        """
        if not (invalid_share > 0).any():
            return probability
        return (probability * self.certainty(invalid_share)[..., np.newaxis]).astype(np.float32)

    def _states(self, invalid_share: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Probabilities (...) of a loss of its own, and of light at the limit."""
        valid = np.rint((1.0 - _known(invalid_share)) * self.frames)
        m, place = np.unique(valid, return_inverse=True)  # few values, and beta functions are slow
        own = _own_density(m, self.frames, self.common)
        chance = _chance_density(m, self.frames, self.common, self.concentration)
        probable = (1.0 - self.by_chance) * own / ((1.0 - self.by_chance) * own + self.by_chance * chance)
        limit = _up_to((1.0 - self.common) / 2.0, m, self.frames) / _up_to(1.0 - self.common, m, self.frames)
        place = place.reshape(valid.shape)
        return probable[place], (probable * limit)[place]


def learn_losses(invalid_share: ArrayLike, frames: int, *, first_quantile: float = 0.25) -> Losses:
    """Learn the losses of the pixels of an image.

    Parameters
    ----------
    invalid_share : (row, col) array_like
        Share of the frames without a valid sample. Pixels without any valid sample do not count: they may be masked.
    frames : int
        Frames of the window, at least 1.
    first_quantile : float
        Quantile of the pixels' losses at which the search for the common one starts. Likelihood alone cannot tell the
        camera's loss from that of a dark thing that fills the image: the smaller one is taken, if a quarter has it.

    Returns
    -------
    Losses
        The maximum of the likelihood that EM finds from there. No loss, if no pixel has a valid sample.
    """
    shares = np.asarray(invalid_share, dtype=np.float64)
    lost, pixels = np.unique(np.rint(shares[shares < 1.0] * frames), return_counts=True)  # without NaN
    if not lost.size or not lost.any():
        return Losses(frames=frames, common=0.0, by_chance=0.5)
    start = lost[np.searchsorted(np.cumsum(pixels), first_quantile * pixels.sum())]
    first = float((start + 0.5) / (frames + 1.0))
    fits = [_fitted(lost, pixels, frames, first, narrowness) for narrowness in _NARROWNESS]
    return max(fits, key=lambda fit: fit[1])[0]


def _fitted(
    lost: FloatArray,
    pixels: NDArray[np.int64],
    frames: int,
    common: float,
    narrowness: float,
    *,
    most_iterations: int = 30,  # of EM
    tolerance: float = 1e-6,  # change of the common loss at which EM stops
) -> tuple[Losses, float]:
    """Losses for one width of the beta distribution, by EM from a common loss on; and their log likelihood."""
    total, valid, by_chance = pixels.sum(), frames - lost, 0.5
    least_common = 1e-9  # common loss that is as good as none
    for _ in range(most_iterations):
        spread = _concentration(common, narrowness)
        chance = by_chance * _chance_density(valid, frames, common, spread)
        own = (1.0 - by_chance) * _own_density(valid, frames, common)
        found = Losses(frames=frames, common=common, by_chance=by_chance, concentration=spread)
        weight = pixels * chance / (chance + own)
        by_chance = float((weight.sum() + 1.0) / (total + 2.0))  # the mean after a uniform prior
        before, common = common, float((weight * lost).sum() / max(weight.sum() * frames, 1e-300))
        common = max(common, least_common)
        if abs(common - before) < tolerance:
            break
    return found, float(pixels @ np.log(chance + own))


def _concentration(common: float, narrowness: float) -> float:
    """Sum of the parameters of a beta distribution of this mean, so many times the least with which it has one peak."""
    least = 1.0 / min(common, 1.0 - common)
    as_binomial = 1e7  # from here on as good as infinite, and differences of beta functions are not exact
    return narrowness * least if narrowness * least < as_binomial else math.inf


def _known(invalid_share: ArrayLike) -> FloatArray:
    return np.asarray(np.nan_to_num(np.asarray(invalid_share, dtype=np.float64)))


def _chance_density(valid: FloatArray, frames: int, common: float, concentration: float) -> FloatArray:
    """Probability of `valid` of so many frames by chance: binomial, or beta-binomial."""
    ways = gammaln(frames + 1.0) - gammaln(valid + 1.0) - gammaln(frames - valid + 1.0)
    if math.isinf(concentration):
        return np.asarray(np.exp(ways + xlog1py(valid, -common) + xlogy(frames - valid, common)))
    a, b = (1.0 - common) * concentration, common * concentration
    return np.asarray(np.exp(ways + betaln(valid + a, frames - valid + b) - betaln(a, b)))


def _own_density(valid: FloatArray, frames: int, common: float) -> FloatArray:
    """Probability of `valid` of so many frames, with a share q that is uniform up to 1 - common."""
    return _up_to(1.0 - common, valid, frames) / ((frames + 1.0) * (1.0 - common))


def _up_to(share: float, valid: FloatArray, frames: int) -> FloatArray:
    """Incomplete beta function of a share, for `valid` of so many frames."""
    return np.asarray(np.maximum(betainc(valid + 1.0, frames - valid + 1.0, share), 1e-300))
