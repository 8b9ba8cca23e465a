"""Lost samples: what a pixel's frames without a valid sample say about its layers, and about the space along its beam.

A sample is lost because its light is too dark or saturates the pixel, because nothing is in range, because the camera
drops mixed samples, or by chance. Nothing in the recording says which. So a lost sample says that its light came from
an unknown place.

What every pixel loses by chance, as a camera with dropped frames does, says nothing about a scene: `common_loss`. A
pixel that loses more may look at a thing that returns no valid sample. Two states of such a pixel are possible:

- Its light is enough. Then a sample is valid more often than not: with the share q > (1 - common) / 2. The valid
  samples are of surfaces in the beam, and a layer is as sure as they make it.
- Its light is at the limit of the camera: q is at most (1 - common) / 2. The few samples that pass are of a surface in
  the beam, or of light from elsewhere (of neighbours, scattered in the lens). The layer is as sure as in the other
  state times the share of the light that came back.

With m of n frames valid, and q uniform beforehand, the second state has the probability
I_((1 - common) / 2)(m + 1, n - m + 1), I being the regularised incomplete beta function.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betainc

from tofmix.arrays import BoolArray, FloatArray

COMMON_QUANTILE = 0.25
"""Quantile of the pixels' losses that is the loss of all. Three quarters of an image may lose more than it for a reason
of their own. It is no minimum, which chance makes too small."""


def common_loss(invalid_share: ArrayLike) -> float:
    """Share of the samples that all pixels of an image lose.

    Parameters
    ----------
    invalid_share : (row, col) array_like
        Share of the frames without a valid sample. Pixels without any valid sample do not count: they may be masked.

    Returns
    -------
    float
        In [0, 1); 0 if no pixel has a valid sample.
    """
    shares = np.asarray(invalid_share, dtype=np.float64)
    seen = shares[shares < 1.0]  # false for NaN
    return float(np.quantile(seen, COMMON_QUANTILE)) if seen.size else 0.0


def returned_share(invalid_share: ArrayLike, common: float) -> FloatArray:
    """Share of the light that came back, of the light that a pixel can give.

    Parameters
    ----------
    invalid_share : (...) array_like
        Share of the frames without a valid sample; NaN counts as 0.
    common : float
        From `common_loss`.

    Returns
    -------
    (...) float64
        In [0, 1]: exactly 1 for a pixel that loses no more than all pixels do.
    """
    lost = np.nan_to_num(np.asarray(invalid_share, dtype=np.float64))
    return np.asarray(np.minimum((1.0 - lost) / (1.0 - common), 1.0))


def is_at_limit(invalid_share: ArrayLike, common: float) -> BoolArray:
    """Whether pixels lose so much that their light is at the limit of the camera rather than enough.

    Parameters
    ----------
    invalid_share : (...) array_like
        Share of the frames without a valid sample; NaN counts as 0.
    common : float
        From `common_loss`.

    Returns
    -------
    (...) bool
        Whether q, at its most probable value, is that of the second state.
    """
    return np.asarray(returned_share(invalid_share, common) <= 0.5)  # noqa: PLR2004  half, as in the two states


def certainty(invalid_share: ArrayLike, frames: int, common: float) -> FloatArray:
    """Factor of the probability of a pixel's layers, for its lost samples.

    Parameters
    ----------
    invalid_share : (...) array_like
        Share of the frames without a valid sample; NaN counts as 0.
    frames : int
        Frames of the window, at least 1.
    common : float
        From `common_loss`.

    Returns
    -------
    (...) float64
        In [0, 1]: exactly 1 for a pixel that loses no more than all pixels do.
    """
    lost = np.nan_to_num(np.asarray(invalid_share, dtype=np.float64))
    valid = np.rint((1.0 - lost) * frames)
    at_limit = betainc(valid + 1.0, frames - valid + 1.0, (1.0 - common) / 2.0)
    return np.asarray(1.0 - at_limit * (1.0 - returned_share(lost, common)))


def weighed(
    probability: NDArray[np.float32], invalid_share: NDArray[np.float32], *, frames: int, common: float
) -> NDArray[np.float32]:
    """Probabilities of layers, with the lost samples of their pixels.

    Parameters
    ----------
    probability : (..., layer) float32
        Of the valid samples; NaN where there is no layer.
    invalid_share : (...) float32
        Share of the frames without a valid sample.
    frames, common
        As for `certainty`.

    Returns
    -------
    (..., layer) float32
        The same bits for a pixel that loses no more than all pixels do.
    """
    if not (invalid_share > 0).any():
        return probability
    return (probability * certainty(invalid_share, frames, common)[..., np.newaxis]).astype(np.float32)
