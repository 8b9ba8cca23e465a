"""Stray light in the lens: every pixel gets a share of the whole image."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number
from tofmix.simulation.effects.search import (
    SMALL_SHARE,
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    of_logarithm,
    spread_of,
)

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class Scattering(Effect):
    """z becomes z + share * M, M the image's expected mean phasor.

    Light is reflected between lens and chip and spreads over the image. Bright near objects shorten the ranges of dark
    far ones: a stray phasor of 1, 3, 10 % of the target's own amplitude, from 1.0 m onto 3.6 m, shortens the range by
    9.8, 29.9, 104 mm at 20 MHz. Surfaces more than half a turn farther appear farther instead. M is weighted by area,
    with 0 for no return, and includes the light effects before this one in the file. The stray light of a real lens
    decreases with the distance in the image; here it is uniform.

    References
    ----------
    Mure-Dubois and Huegli, Real-time scattering compensation for time-of-flight camera, ICVS 2007. Kavli et al.,
    Modelling and compensating measurement errors caused by scattering in time-of-flight cameras, SPIE, 2008.
    """

    kind: ClassVar[str] = "scattering"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "bias towards the bright surfaces, largest where the image is dark"
    typical: ClassVar[str] = (
        "a stray phasor of 1, 3, 10 % of the target's own amplitude, from 1.0 m onto 3.6 m at 20 MHz: "
        "-9.8, -29.9, -104 mm"
    )
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")
    acts_on_phase: ClassVar[bool] = True
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "the same scene without its brightest surface",
        "wiggling": "the same scene without its brightest surface",
        "multipath": "the same scene without its brightest surface",
        "amplitude_walk": "the same scene without its brightest surface",
    }

    share: float = number(
        "Share of the mean phasor that each pixel gets.",
        unit="1",
        low=0,
        high=1,
        high_open=True,
        zero=0,
        typical=(0.001, 0.1),
        prior=StudentPrior(scale=0.05, half=True),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:  # noqa: ARG003
        """By the logarithm of the share."""
        yield of_logarithm(cls, "share", (0.002, 0.02, 0.1))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:  # noqa: ARG003
        """The share."""
        one = Coefficient(effect=cls(share=SMALL_SHARE), size=SMALL_SHARE, spread=spread_of(cls, "share"))
        yield LinearForm(coefficients=(one,), make=lambda c: cls(share=float(c[0])))

    def explain(self) -> str:
        """One sentence."""
        return f"each sample gets {100 * self.share:g} % of the image's mean light on top of its own"

    def expect(self, prediction: "Prediction", context: Context) -> complex:  # noqa: ARG002
        """M."""
        return complex((prediction.area() * prediction.phasor()).sum() / prediction.shape[1])

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the stray phasor."""
        z = echoes.phasor()
        echoes.replace_phasor(z, z + self.share * context.expected)
