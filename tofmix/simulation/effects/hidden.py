"""The hidden states that link the samples of an effect, as an effect declares them: `Effect.hidden`.

A declaration says which numbers of the effect have which part in its hidden state. `reconcile` has one likelihood, one
fit and one error for each sort of hidden state, and knows no kind: a new kind declares one of these.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.simulation.effects.parameter import PixelMap


class _HasKind(Protocol):
    @property
    def kind(self) -> str: ...


_Effect = TypeVar("_Effect", bound=_HasKind)
_MAP = "map"  # the field of every effect with a map


class FrameChain(NamedTuple):
    """A Markov chain of two states, quiet and disturbed, that adds noise to disturbed frames; or a beat.

    Share of disturbed frames; noise that they add, mm; mean length of a burst of them, frames; period of a beat,
    frames, 0 for a chain. A beat adds its noise times `overlap`.
    """

    probability: float
    sigma_mm: float
    burst_frames: float
    period_frames: float = 0.0

    def overlap(self, frame: NDArray[Any], phase: FloatArray | float) -> FloatArray:
        """Overlap (frame,) of the exposures of two cameras, 0 to 1, at some frames; `phase`, in periods, broadcasts.

        Both exposures last for half of `probability` of the period, so that the overlap is a triangle in time.
        """
        away = np.abs((frame / self.period_frames + phase + 0.5) % 1.0 - 0.5)
        return np.asarray(np.maximum(1.0 - 2.0 * away / self.probability, 0.0))


class PatternSpreads(NamedTuple):
    """Standard deviations of a pattern's biases by pixel, column and row, mm."""

    pixel_sigma_mm: float
    column_sigma_mm: float
    row_sigma_mm: float


@dataclass(frozen=True, slots=True)
class HiddenState:
    """A hidden state. Use a subclass.

    Parameters
    ----------
    numbers : tuple of str
        Parameters of the effect that describe it, in the order of the subclass.
    """

    numbers: tuple[str, ...] = ()

    @property
    def forms(self) -> int:
        """Forms of the state that have a fit of their own, each told from the others by `form`."""
        return 1

    def form(self, effect: object) -> int:  # noqa: ARG002
        """Number of an effect's form, from 0; each form beyond the first has the price of one more effect."""
        return 0

    def made(self, kind: type[_Effect], values: Sequence[float]) -> _Effect:
        """An effect of a kind with these values of `numbers`; ValueError out of bounds."""
        return kind(**dict(zip(self.numbers, values, strict=True)))

    def changed(self, effect: _Effect, values: Sequence[float]) -> _Effect:
        """The effect with other values of `numbers`; ValueError out of bounds."""
        new: dict[str, Any] = dict(zip(self.numbers, values, strict=True))
        of: Any = effect
        return replace(of, **new)  # type: ignore[no-any-return]

    def values(self, effect: object) -> tuple[float, ...]:
        """Values of `numbers`."""
        return tuple(float(getattr(effect, name)) for name in self.numbers)


@dataclass(frozen=True, slots=True)
class DisturbedFrames(HiddenState):
    """Each frame is quiet or disturbed, or beats; `numbers` are those of a chain.

    Parameters
    ----------
    period : str
        Parameter of the effect that is the period of a beat, frames, None for a chain; empty for kinds without a beat.
    """

    period: str = ""

    @property
    def forms(self) -> int:
        """Bursts, and a beat if the kind may have one."""
        return 2 if self.period else 1

    def form(self, effect: object) -> int:
        """1 of a beat."""
        return int(self.chain(effect).period_frames > 0)

    def made(self, kind: type[_Effect], values: Sequence[float]) -> _Effect:
        """An effect of a kind with these values of `numbers`, and with the period that may follow them."""
        return kind(**self._named(values))

    def changed(self, effect: _Effect, values: Sequence[float]) -> _Effect:
        """The effect with other values, likewise."""
        of: Any = effect
        return replace(of, **self._named(values))  # type: ignore[no-any-return]

    def chain(self, effect: object) -> FrameChain:
        """The chain of an effect."""
        period = getattr(effect, self.period) if self.period else None
        probability, sigma_mm, burst_frames = self.values(effect)
        return FrameChain(probability, sigma_mm, burst_frames, period or 0.0)

    def _named(self, values: Sequence[float]) -> dict[str, Any]:
        own: dict[str, Any] = dict(zip(self.numbers, values, strict=False))
        period = values[len(self.numbers) :]
        if not (self.period and period and period[0]):
            return own
        del own[self.numbers[2]]  # a beat has no bursts
        return own | {self.period: period[0]}


@dataclass(frozen=True, slots=True)
class RememberedNoise(HiddenState):
    """The noise of a pixel is AR(1) from frame to frame; the number is its coefficient."""

    def coefficient(self, effect: object) -> float:
        """The coefficient of an effect."""
        return self.values(effect)[0]


@dataclass(frozen=True, slots=True)
class RangeStep(HiddenState):
    """Samples are rounded to multiples of a step; the number is the step, mm."""

    def step_mm(self, effect: object) -> float:
        """The step of an effect."""
        return self.values(effect)[0]


@dataclass(frozen=True, slots=True)
class AffectedPixels(HiddenState):
    """Each pixel is affected or not, the same in all frames; the number is the share of affected pixels.

    `Effect.in_affected` is what acts in an affected pixel.
    """

    @property
    def forms(self) -> int:
        """None: the share is a number of the effect like others."""
        return 0

    def share(self, effect: object) -> float:
        """The share of an effect."""
        return self.values(effect)[0]


@dataclass(frozen=True, slots=True)
class _Mapped(HiddenState):
    """A value of each pixel, in the effect's map once it is known."""

    def map_of(self, effect: object) -> PixelMap | None:
        """The map of an effect; None if its values are not known."""
        known: PixelMap | None = getattr(effect, _MAP)
        return known

    def with_map(self, effect: _Effect, values: Any) -> _Effect:  # noqa: ANN401  an array of any real dtype
        """The effect with a map (row, col); its file has the name of the kind."""
        new: dict[str, Any] = {_MAP: PixelMap(f"{effect.kind}.npy", values)}
        of: Any = effect
        return replace(of, **new)  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class PixelBias(_Mapped):
    """Each pixel has a bias; `numbers` are those of `PatternSpreads`, the map has the biases, mm."""

    def spreads(self, effect: object) -> PatternSpreads:
        """The spreads of an effect."""
        return PatternSpreads(*self.values(effect))


@dataclass(frozen=True, slots=True)
class PixelValue(_Mapped):
    """Some pixels return one value; the map has it, mm, and NaN for the others."""
