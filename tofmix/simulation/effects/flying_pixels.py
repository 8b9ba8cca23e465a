"""Mixed pixels: the alternative to equation (1), in which one sample mixes all surfaces of the pixel."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.simulation.echoes import ComplexArray, Echoes, FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import UniformPrior, number
from tofmix.simulation.effects.search import Problem, SearchFacts, of_logarithm

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction

_SEVERAL = 2  # surfaces at least, whose light mixes


@dataclass(frozen=True, slots=True, kw_only=True)
class FlyingPixels(Effect):
    """With `probability`, a pixel that sees several surfaces, or a surface and nothing, returns the phasor sum of all.

    A pixel collects the light of its whole beam, so the physics of one exposure is the phasor sum, z = sum_i share_i
    A_i exp(2 pi i r_i / d_u): a range between the surfaces. Open space adds nothing. So a surface next to open space
    keeps its range, with its share of the amplitude. In equation (1) each sample shows one surface or none. Probability
    0 is equation (1), and 1 is the phasor sum. Each pixel and frame is drawn independently of the surface that equation
    (1) drew. The sigma of a mixed sample is sigma(r) |z| / |z'|, with r and z of the drawn surface; if no return was
    drawn, with r and z of the surface with the most light. Light effects before this one in the file act on the phasors
    of the surfaces.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008: the "comet tail" of on-board averaging.
    """

    kind: ClassVar[str] = "flying_pixels"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "samples between the surfaces of a pixel"
    typical: ClassVar[str] = "1 for one exposure of a lock-in camera; 0 is equation (1)"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.MIXTURE
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "skew", "spread", "bridging")
    acts_on_phase: ClassVar[bool] = True
    separated_from: ClassVar[Mapping[str, str]] = {
        "pixel_crosstalk": "edges between surfaces of very different brightness",
    }

    probability: float = number(
        "Share of the samples that mix.",
        unit="1",
        low=0,
        high=1,
        zero=0,
        typical=(0.05, 1),
        prior=UniformPrior(low=0, high=1),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:  # noqa: ARG003
        """By the logarithm of the probability."""
        yield of_logarithm(cls, "probability", (0.01, 0.1, 0.6))

    def explain(self) -> str:
        """One sentence."""
        return (
            f"in pixels that see several surfaces, or a surface and nothing, {100 * self.probability:g} % of the "
            "samples are the phasor sum of all: between several surfaces, at a range without a surface"
        )

    def expect(self, prediction: "Prediction", context: Context) -> "_Mixed":  # noqa: ARG002
        """The mixed samples and their pixels."""
        area = prediction.area()
        seen = np.zeros(prediction.shape[1], dtype=np.int64)
        for number_ in np.unique(prediction.surface[area > 0]):
            seen += ((prediction.surface == number_) & (area > 0)).any(axis=0)
        dark = ~prediction.returned & (prediction.weight > 0)
        pixel = np.arange(prediction.shape[1])
        at = np.argmax(area * prediction.amplitude, axis=0), pixel
        nothing = np.argmax(dark, axis=0), pixel
        gap = dark.any(axis=0)
        return _Mixed(
            phasor=(area * prediction.phasor()).sum(axis=0),
            mixes=(seen >= _SEVERAL) | ((seen > 0) & gap),
            surface=prediction.surface[at],
            true_range_mm=prediction.true_range_mm[at],
            range_mm=prediction.range_mm[at],
            amplitude=prediction.amplitude[at],
            sigma_ratio=np.where(gap, prediction.sigma_mm[at] / prediction.sigma_mm[nothing], 1.0),
        )

    def act(self, echoes: Echoes, context: Context) -> None:
        """Mix every echo of a pixel that sees several surfaces, or a surface and nothing."""
        self._mix(echoes, context.expected, context.expected.mixes)

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Mix those that chance picks."""
        picked = context.frame_rng(self).random(samples.shape) < self.probability
        self._mix(samples, context.expected, context.expected.mixes & picked)

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """Every component splits in two, no return included."""
        plain, flying = prediction.split(np.where(context.expected.mixes, self.probability, 0.0))
        self.act(flying, context)
        prediction.join(plain, flying)

    @staticmethod
    def _mix(echoes: Echoes, mixed: "_Mixed", picked: BoolArray) -> None:
        dark = picked & ~echoes.returned
        echoes.surface = np.where(dark, mixed.surface, echoes.surface)
        echoes.true_range_mm = np.where(dark, mixed.true_range_mm, echoes.true_range_mm)
        echoes.range_mm = np.where(dark, mixed.range_mm, echoes.range_mm)
        echoes.amplitude = np.where(dark, mixed.amplitude, echoes.amplitude)
        echoes.sigma_mm = np.where(dark, echoes.sigma_mm * mixed.sigma_ratio, echoes.sigma_mm)
        z = echoes.phasor()
        echoes.replace_phasor(z, np.where(picked, mixed.phasor, z))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Mixed:
    """Components of a frame's mixed samples; arrays are (pixel,).

    A no-return sample has neither turn nor noise. It takes both from the surface with the most light, share times
    amplitude.

    Parameters
    ----------
    phasor : complex128
        The phasor sum.
    mixes : bool
        Pixels that see several surfaces, or a surface and nothing.
    surface, true_range_mm, range_mm, amplitude
        Of the surface with the most light.
    sigma_ratio : float64
        Its sigma over that of no return, the same at every integration time and pixel's width.
    """

    phasor: ComplexArray
    mixes: BoolArray
    surface: IntArray
    true_range_mm: FloatArray
    range_mm: FloatArray
    amplitude: FloatArray
    sigma_ratio: FloatArray
