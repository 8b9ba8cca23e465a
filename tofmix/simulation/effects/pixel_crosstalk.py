"""Light or charge that leaks into neighbouring pixels."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.simulation.echoes import ComplexArray, Echoes, FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number
from tofmix.simulation.effects.search import Problem, SearchFacts, of_logarithm

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction

_SURE = 1e-9  # share of a beam that rounding may leave beside one surface


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelCrosstalk(Effect):
    """z becomes (1 - 4 share) z + share (sum of the four neighbours' z in that frame), the image's edge repeated.

    Charge diffuses between pixels, and a lens out of focus spreads a point over several. A share of some per cent is
    usual for either. Ranges near edges move towards the other surface, and the samples of the neighbours add to the
    spread of a pixel. Samples without a return have z = 0 and do not change.
    """

    kind: ClassVar[str] = "pixel_crosstalk"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "bias and spread where neighbours differ; correlation between neighbours"
    typical: ClassVar[str] = "shares of some 0.01"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.MIXTURE
    links_neighbours: ClassVar[bool] = True
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "spread", "bridging")
    acts_on_phase: ClassVar[bool] = True
    predicts: ClassVar[str] = (
        "mean and variance of each component, given what the two most uncertain neighbours see, from the mean and "
        "variance of the others' phasors (to first order in the share); exact where the neighbours see one surface each"
    )

    share: float = number(
        "Share that each neighbour gets.",
        unit="1",
        low=0,
        high=0.25,
        high_open=True,
        zero=0,
        typical=(0.002, 0.05),
        prior=StudentPrior(scale=0.025, half=True),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:  # noqa: ARG003
        """By the logarithm of the share."""
        yield of_logarithm(cls, "share", (0.003, 0.03))

    def explain(self) -> str:
        """One sentence."""
        return f"each pixel leaks {100 * self.share:g} % of its light into each of its four neighbours"

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Mix with the neighbours' samples of this frame."""
        z = samples.phasor()
        shape = (context.sensor.rows, context.sensor.cols)
        leaked = _neighbours(z.reshape(shape)).ravel()
        samples.replace_phasor(z, (1 - 4 * self.share) * z + self.share * leaked)

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """Keep the surfaces of the two most uncertain neighbours separate; use two moments of the others."""
        shape = (context.sensor.rows, context.sensor.cols)
        z, area = prediction.phasor(), prediction.area()
        all_, top, rest = _moments(z, area)
        own = _own(shape).ravel()
        sums = _Moments(*(_neighbours(m.reshape(shape)).ravel() - own * m for m in all_))
        parts = [(prediction, sums)]
        for near in _uncertain(all_.power.real.reshape(shape)):
            likely = np.where(near >= 0, area.max(axis=0)[near], 1.0)
            split = np.where(near >= 0, 1.0 - likely, 0.0)
            parts = [
                (half, _swapped(seen, all_, new, near, split > 0))
                for part, seen in parts
                for half, new in zip(part.split(split), (top, rest), strict=True)
            ]
        for part, seen in parts:
            phasor = part.phasor()
            mixed = (1 - (4 - own) * self.share) * phasor + self.share * seen.mean
            part.replace_phasor(phasor, mixed)
            self._widen(part, seen.power, seen.square, phasor, mixed)
        prediction.join(parts[0][0], parts[1][0])
        for part, _ in parts[2:]:
            prediction.join(prediction, part)

    def _widen(
        self, echoes: Echoes, power: ComplexArray, square: ComplexArray, z: ComplexArray, mixed: ComplexArray
    ) -> None:
        """Add the variance across the phasor, which turns it."""
        lit = echoes.returned & (z != 0) & (mixed != 0)
        length = np.abs(np.where(lit, mixed, 1.0))
        across = np.where(lit, mixed / length, 1.0) * 1j
        variance = 0.5 * (power.real + (across.conj() ** 2 * square).real)
        turned = np.maximum(variance, 0.0) * (self.share * echoes.turn_mm / (2 * math.pi) / length) ** 2
        echoes.sigma_mm = np.where(lit, np.sqrt(echoes.sigma_mm**2 + turned), echoes.sigma_mm)


class _Moments(NamedTuple):
    """Of phasors (pixel,): mean, and about it the means of the squared length and of the square."""

    mean: ComplexArray
    power: ComplexArray
    square: ComplexArray


def _moments(z: ComplexArray, area: FloatArray) -> tuple[_Moments, _Moments, _Moments]:
    """Moments of each pixel's phasor: in all, given its likeliest surface, and given any other event."""
    heaviest = area.argmax(axis=0)[None]
    share, top = (np.take_along_axis(v, heaviest, axis=0)[0] for v in (area, z))
    raw = [(area * v).sum(axis=0) for v in (z, np.abs(z) ** 2 + 0j, z**2)]
    left = np.where(share < 1.0 - _SURE, 1.0 - share, 1.0)
    others = [(r - share * v) / left for r, v in zip(raw, (top, np.abs(top) ** 2, top**2), strict=True)]
    none = np.zeros_like(top)
    return _central(raw), _Moments(top, none, none), _central(others)


def _central(raw: list[ComplexArray]) -> _Moments:
    mean, power, square = raw
    return _Moments(mean, power - np.abs(mean) ** 2, square - mean**2)


def _uncertain(power: FloatArray) -> Iterator[IntArray]:
    """Numbers (pixel,) of the neighbours whose events differ most, the first and the second; -1 where none does."""
    rows, cols = power.shape
    number = np.pad(np.arange(rows * cols).reshape(rows, cols), 1, constant_values=-1)
    near = np.stack([number[:-2, 1:-1], number[2:, 1:-1], number[1:-1, :-2], number[1:-1, 2:]]).reshape(4, -1)
    differs = np.where(near >= 0, power.ravel()[near], 0.0)
    near = np.where(differs > _SURE * differs.max(), near, -1)
    order = np.argsort(-differs, axis=0, kind="stable")
    for lead in order[:2]:  # neighbours whose events are told apart
        yield np.take_along_axis(near, lead[None], axis=0)[0]


def _swapped(sums: _Moments, old: _Moments, new: _Moments, near: IntArray, where: BoolArray) -> _Moments:
    """Sums over the neighbours, with other moments of one of them."""
    return _Moments(*(s + np.where(where, n[near] - o[near], 0.0) for s, o, n in zip(sums, old, new, strict=True)))


def _neighbours(image: ComplexArray) -> ComplexArray:
    """Sum of the four neighbours (row, col), the edge repeated."""
    framed = np.pad(image, 1, mode="edge")
    return framed[:-2, 1:-1] + framed[2:, 1:-1] + framed[1:-1, :-2] + framed[1:-1, 2:]


def _own(shape: tuple[int, int]) -> ComplexArray:
    """How many of a pixel's four neighbours are the pixel itself, by the repeated edge."""
    own = np.zeros(shape, dtype=np.complex128)
    own[0] += 1
    own[-1] += 1
    own[:, 0] += 1
    own[:, -1] += 1
    return own
