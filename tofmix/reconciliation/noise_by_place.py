"""Whether measured noise differs from the model's by a law of the camera, or by place.

A noise curve that is learnt from a recording fits that recording, also where one board is in the sun: the board has
ranges of its own, and the curve gets a step there. Use `uneven_noise` before a measured curve stands for the camera's.

The measured sigma over the model's is compared between surfaces, within surfaces, and between parts of the image. If a
camera's curve differs from the model's by range, the ratio changes with range, also within a surface. If it differs by
place, each surface has a factor of its own, and the model's curve holds within it.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.comparison.localise import LEAST_SIZE
from tofmix.reconciliation.likelihood.joint import Recording, joint_likelihood
from tofmix.reconciliation.likelihood.likelihood import ModelState
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.verdict import LAW

BY_RANGE = 0.5
"""Share of the change between surfaces that must be seen within them, at the same ranges: 1 for a law of range, 0 for a
factor of each surface."""

_TILES = 6  # parts of the image, along each side
_LEAST_PIXELS = 12  # of a surface or of a part of the image
_TWO = 2  # surfaces, at least, that can differ


@dataclass(frozen=True, slots=True, kw_only=True)
class Uneven:
    """A place with other noise than the model's curve and the rest of the scene.

    Parameters
    ----------
    place : str
        The place, in words.
    ratio, elsewhere : float
        Measured sigma over the model's, there and in the median of the other surfaces, or of the rest of the surface.
    """

    place: str
    ratio: float
    elsewhere: float

    @property
    def sentence(self) -> str:
        """The difference, and the next step."""
        return (
            f"The noise differs from the model's curve by place: {self.place} it is {self.ratio:.2f} times the model's,"
            f" elsewhere {self.elsewhere:.2f} times, and no curve of range gives that. Look for the cause there, such"
            " as sunlight or another material, and record without it; --noise measured goes on with this noise."
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ratios:
    """Log of measured sigma over the model's (pixel,), of the pixels that see a surface of one recording.

    `by` are the logarithms of what a noise curve depends on: range, and amplitude if the measured curve does.
    """

    value: FloatArray
    by: tuple[FloatArray, ...]
    surface: IntArray
    tile: IntArray
    names: tuple[str, ...]
    image: tuple[int, int]
    error: float


def uneven_noise(
    given: Sequence[Recording], measured: Sequence[Recording], state: ModelState, alpha: float
) -> Uneven | None:
    """The place whose noise differs most from the rest by no law of range or amplitude; None without one.

    Parameters
    ----------
    given, measured : sequence of (Model, Evidence)
        The recordings, with the models as given, and with the measured noise.
    state : State
        Of the measured models: the effects that were found, and the pixels' own widths.
    alpha : float
        Level of the test that a part of the image differs, corrected for their number.
    """
    found = [place for ratios in _ratios(given, measured, state) for place in _places(ratios, alpha)]
    return max(found, key=_weight, default=None)


def _weight(place: Uneven) -> tuple[float, float]:
    """How much a place differs from the rest, and from the model: of two surfaces, the second decides."""
    return round(abs(math.log(place.ratio / place.elsewhere)), 2), abs(math.log(place.ratio))


def _ratios(given: Sequence[Recording], measured: Sequence[Recording], state: ModelState) -> Iterator[_Ratios]:
    bare = replace(state, log_width=np.zeros_like(state.log_width))
    own, other = joint_likelihood(given), joint_likelihood(measured)
    for number, (scene, with_noise) in enumerate(zip(own.scene.members, other.scene.members, strict=True)):
        was, now = (s.mixture(s.own(bare.effects)) for s in (scene, with_noise))
        lit = now.of_main(now.lit).astype(bool) & was.of_main(was.lit).astype(bool) & state.working
        ratio = np.log(now.of_main(now.sigma) / was.of_main(was.sigma)) + state.log_width[number]
        rows, cols = own.evidence.image
        row, col = np.divmod(np.flatnonzero(lit), cols)
        curve, samples = with_noise.model.sensor.noise, given[number][1].samples[:, lit]
        yield _Ratios(
            value=ratio[lit],
            by=_arguments(now, lit, by_amplitude=curve.law is not None),
            surface=now.of_main(now.surface)[lit],
            tile=row * _TILES // rows * _TILES + col * _TILES // cols,
            names=tuple(s.name for s in given[number][0].surfaces),
            image=(rows, cols),
            error=math.sqrt(curve.range_mm.size / max(2 * int((samples > 0).sum()), 1)),
        )


def _arguments(mixture: Mixture, lit: BoolArray, *, by_amplitude: bool) -> tuple[FloatArray, ...]:
    values = [mixture.of_main(mixture.true_range)]
    values += [mixture.of_main(mixture.amplitude)] if by_amplitude else []
    return tuple(np.log(np.maximum(v[lit], 1e-9)) for v in values)


def _places(ratios: _Ratios, alpha: float) -> Iterator[Uneven]:
    """Surfaces with a factor of their own, and parts of the image that differ within their surface."""
    numbers = [int(k) for k in np.unique(ratios.surface) if (ratios.surface == k).sum() >= _LEAST_PIXELS]
    own = {k: ratios.surface == k for k in numbers}
    factor = {k: float(ratios.value[own[k]].mean()) for k in numbers}
    limit = float(norm.isf(alpha / (2 * (len(numbers) + _TILES**2))))
    least = LEAST_SIZE + limit * ratios.error
    if len(numbers) >= _TWO and max(_seen_within(ratios, own, by) for by in ratios.by) < BY_RANGE:
        for k in numbers:
            others = float(np.median([factor[j] for j in numbers if j != k]))
            if abs(factor[k] - others) > least:
                yield Uneven(place=f'on "{ratios.names[k]}"', ratio=math.exp(factor[k]), elsewhere=math.exp(others))
    for k in numbers:
        yield from _tiles(ratios, own[k], (limit, least))


def _seen_within(ratios: _Ratios, own: dict[int, BoolArray], by: FloatArray) -> float:
    """Slope of the ratio's change within surfaces on the change that a law through their means has there."""
    order = sorted(own, key=lambda k: float(by[own[k]].mean()))
    at = np.array([by[own[k]].mean() for k in order])
    mean = np.array([ratios.value[own[k]].mean() for k in order])
    slopes = np.gradient(mean, at) if np.all(np.diff(at) > 0) else np.zeros(len(order))
    law = np.concatenate([slope * (by[own[k]] - x) for k, slope, x in zip(order, slopes, at, strict=True)])
    seen = np.concatenate([ratios.value[own[k]] - y for k, y in zip(order, mean, strict=True)])
    power = float(law @ law)
    return float(law @ seen) / power if power > 0 else 0.0


def _tiles(ratios: _Ratios, own: BoolArray, limits: tuple[float, float]) -> Iterator[Uneven]:
    """Parts of the image with another mean than the surface's own power law of range or amplitude leaves to them."""
    y = ratios.value[own]
    columns = np.stack([np.ones_like(y), *(by[own] for by in ratios.by)], axis=1)
    law = columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    rest, spread = y - law, LAW * float(np.std(law))
    limit, least = limits
    tile = ratios.tile[own]
    for k in np.unique(tile):
        inside = tile == k
        n = int(inside.sum())
        if n < _LEAST_PIXELS or n == inside.size:
            continue
        there, elsewhere = float(rest[inside].mean()), float(np.median(rest[~inside]))
        error = float(rest[inside].std()) / math.sqrt(n)
        if abs(there - elsewhere) > limit * error + spread + least:
            yield Uneven(
                place=_words(int(k), ratios.image),
                ratio=math.exp(float(y[inside].mean())),
                elsewhere=math.exp(float(y[~inside].mean())),
            )


def _words(tile: int, image: tuple[int, int]) -> str:
    """The rows and columns of a part of the image."""
    row, col = divmod(tile, _TILES)
    limits = [(-(-k * n // _TILES), -(-(k + 1) * n // _TILES) - 1) for k, n in ((row, image[0]), (col, image[1]))]
    (top, bottom), (left, right) = limits
    return f"in rows {top} to {bottom}, columns {left} to {right},"
