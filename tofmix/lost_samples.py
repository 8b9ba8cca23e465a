"""Lost samples: what a pixel's frames without a valid sample say about its layers, and about the space along its beam.

A sample is lost because its light is too dark or saturates the pixel, because nothing is in range, because the camera
drops mixed samples, or by chance. Nothing in the recording says which. So a lost sample says that its light came from
an unknown place. Of n frames, m have a valid sample:

- By chance. Every pixel loses the same share of its samples, as with dropped frames: m is binomial, of the share
  1 - common. Such losses say nothing about the scene, and a layer is as sure as the valid samples make it.
- A loss of its own. A sample is valid with an unknown share q, uniform between 0 and 1 - common. If q is above the
  middle, the pixel's light is enough: a sample is valid more often than not, and is of a surface in the beam. Else the
  light is at the limit of the camera. The few samples that pass are of a surface in the beam, or of light from
  elsewhere (of neighbours, scattered in the lens). A layer then is as sure as else times the share of the light that
  came back.

The common loss and the share of the pixels without a loss of their own are learnt from the image, by maximum
likelihood. Integrals over q are regularised incomplete beta functions: that of the binomial probability of m up to q is
I_q(m + 1, n - m + 1) / (n + 1).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betainc, gammaln, xlog1py, xlogy

from tofmix.arrays import BoolArray, FloatArray

_ITERATIONS = 100  # of EM, at most
_CHANGE = 1e-6  # of the common loss, at which EM stops


@dataclass(frozen=True, slots=True, kw_only=True)
class Losses:
    """Losses of the pixels of an image.

    Parameters
    ----------
    frames : int
        Frames of the window, n.
    common : float
        Share of the samples that every pixel loses by chance, in [0, 1).
    by_chance : float
        Share of the pixels without a loss of their own, in (0, 1).
    """

    frames: int
    common: float
    by_chance: float

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
        chance = _chance_density(m, self.frames, self.common)
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
    total, valid = pixels.sum(), frames - lost
    start = lost[np.searchsorted(np.cumsum(pixels), first_quantile * total)]
    common, by_chance = float((start + 0.5) / (frames + 1.0)), 0.5
    for _ in range(_ITERATIONS):
        chance = by_chance * _chance_density(valid, frames, common)
        own = (1.0 - by_chance) * _own_density(valid, frames, common)
        weight = pixels * chance / (chance + own)
        by_chance = float((weight.sum() + 1.0) / (total + 2.0))  # the mean after a uniform prior
        before, common = common, float((weight * lost).sum() / max(weight.sum() * frames, 1e-300))
        if abs(common - before) < _CHANGE:
            break
    return Losses(frames=frames, common=common, by_chance=by_chance)


def _known(invalid_share: ArrayLike) -> FloatArray:
    return np.asarray(np.nan_to_num(np.asarray(invalid_share, dtype=np.float64)))


def _chance_density(valid: FloatArray, frames: int, common: float) -> FloatArray:
    """Binomial probability of `valid` of so many frames, if the share `common` is lost."""
    ways = gammaln(frames + 1.0) - gammaln(valid + 1.0) - gammaln(frames - valid + 1.0)
    return np.asarray(np.exp(ways + xlog1py(valid, -common) + xlogy(frames - valid, common)))


def _own_density(valid: FloatArray, frames: int, common: float) -> FloatArray:
    """Probability of `valid` of so many frames, with a share q that is uniform up to 1 - common."""
    return _up_to(1.0 - common, valid, frames) / ((frames + 1.0) * (1.0 - common))


def _up_to(share: float, valid: FloatArray, frames: int) -> FloatArray:
    """Incomplete beta function of a share, for `valid` of so many frames."""
    return np.asarray(np.maximum(betainc(valid + 1.0, frames - valid + 1.0, share), 1e-300))
