"""A second camera that lights the scene: in bursts of frames, with a beat, or always; everywhere or in a part."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import Echoes, FrameSamples
from tofmix.simulation.effects import spot
from tofmix.simulation.effects.base import Context, Effect, EffectTruth, Latent, Level, Target
from tofmix.simulation.effects.hidden import DisturbedFrames, FrameChain, HiddenState
from tofmix.simulation.effects.parameter import PixelMap, Prior, UniformPrior, about, number, pixel_map
from tofmix.simulation.effects.search import EFFECT_NATS, Problem, SearchFacts, bounded, image_places

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction

_STARTS = (0.5, 1.5, 4.0)
"""Noise of a camera that is always on, over the typical noise, where searches begin."""

_ALWAYS = "always on"
_IN_A_PART = "always on, in a part of the image"
"""Names of the forms."""

_SPLIT = 4
"""Equally likely overlaps for which a beat is predicted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interference(Effect):
    """Noise of `sigma_mm` is added in quadrature to every pixel that sees a surface: in bursts, with a beat, or always.

    The light of a second camera has another phase: over one exposure it adds a phasor of random phase. While it does,
    the noise is some cm to some ten cm (a foreign phasor of 10 % of the target's own changes the range by up to 120 mm
    at 20 MHz). It does so

    in bursts, without `period_frames`: a two-state Markov chain disturbs frames. Bursts last `burst_frames` on average,
    and pauses have the length that gives the share `probability` of all frames. If pauses would be shorter than a
    frame, they last one frame and the bursts are longer;

    with a beat of `period_frames`: the frame rates of the cameras differ by a little, so that their exposures overlap
    for a time and then do not. The overlap rises and falls in proportion to time, as the exposures slide over each
    other, and the noise is `sigma_mm` times the overlap: most in the middle of the disturbed frames, which are the
    share `probability` of a period. Its phase is drawn;

    always, where `probability` is 1 and there is no period: light whose frames do not keep to any clock, such as that
    of a camera with many short exposures. Told from `excess_noise` where sigma differs over the image, since the noise
    is added and not multiplied.

    The second camera may light a part of the image. With the four numbers of a spot, the noise is `sigma_mm` times a
    Gaussian of the pixel's place: 1 in the middle, exp(-1/2) at the radii. A `map` is the part of the noise, 0 to 1,
    that each pixel receives. `reconcile` looks for bursts, for a beat and for a camera that is always on, everywhere or
    in a spot (a beat, and always, at the price of one more effect), but for no map.

    References
    ----------
    Buettgen and Seitz, Robust optical time-of-flight range imaging, IEEE Trans. Circuits and Systems I 55(6), 2008.
    """

    kind: ClassVar[str] = "interference"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "spread of the whole image in bursts of frames, with a beat, or always; no bias"
    typical: ClassVar[str] = "up to 120 mm at 20 MHz for a foreign phasor of 10 % of the target's own"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.SPREAD
    shows_in: ClassVar[tuple[str, ...]] = ("bursts", "common_mode", "spread")
    magnitudes: ClassVar[tuple[str, ...]] = ("sigma_mm",)  # of one that is always on, the share has no error
    latent: ClassVar[Latent] = Latent.FRAME
    hidden: ClassVar[HiddenState | None] = DisturbedFrames(
        ("probability", "sigma_mm", "burst_frames"), period="period_frames"
    )
    predicts: ClassVar[str] = (
        "exact for a single sample in bursts, a mixture of disturbed and quiet frames, and where it is always on;"
        f" approximate with a beat, a mixture of {_SPLIT} overlaps and none. A latent state of each frame disturbs all"
        " its pixels together"
    )
    separated_from: ClassVar[Mapping[str, str]] = {
        "excess_noise": "surfaces at several distances, whose noise differs",
    }
    remedy: ClassVar[str] = "Switch other cameras off, or cover this one's light: noise that remains is theirs."

    probability: float = number(
        "Share of the frames that are disturbed.",
        unit="1",
        low=0,
        high=1,
        zero=0,
        typical=(0.02, 0.5),
        prior=UniformPrior(low=0, high=1),
    )
    sigma_mm: float = number(
        "Noise that it adds.", unit="mm", low=0, high=10_000, zero=0, typical=(5, 200), prior=about(50, 3.3)
    )
    burst_frames: float = number(
        "Mean length of a burst.", unit="frame", low=1, high=1e6, default=5, typical=(2, 20), prior=about(5, 3)
    )
    period_frames: float | None = number(
        "Period of a beat, in place of bursts; at least 2.",
        unit="frame",
        low=2,
        high=1e6,
        required=False,
        typical=(10, 200),
        prior=about(50, 4),
    )
    spot_across: float | None = spot.place("to the right of")
    spot_down: float | None = spot.place("below")
    spot_radius_across: float | None = spot.radius("rows")
    spot_radius_down: float | None = spot.radius("columns")
    map: PixelMap | None = pixel_map("Part of the noise that each pixel has, 0 to 1.", unit="1")  # noqa: RUF009

    def __post_init__(self) -> None:
        Effect.__post_init__(self)
        spot.of(self)

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """By the logarithm of the noise of a camera that is always on, everywhere or in a spot that the noise shows.

        Bursts and beats are found by their frames.
        """
        most = math.log(cls.parameters()["sigma_mm"].high)

        def make(x: FloatArray) -> Effect:
            return cls(probability=1.0, sigma_mm=math.exp(bounded(x[0], -5, most)))

        def in_a_part(x: FloatArray) -> Effect:
            return cls(probability=1.0, sigma_mm=math.exp(bounded(x[0], -5, most)), **spot.from_vector(x[1:]))

        starts = tuple((math.log(part * facts.sigma_mm),) for part in _STARTS)
        yield Problem(make=make, starts=starts, steps=(0.3,), form=_ALWAYS, price_nats=EFFECT_NATS)
        # the variance is the square of the noise, and falls off with the square of the light
        spots = tuple(
            (0.5 * math.log(size), *x[:2], *(x[2:] + 0.5 * math.log(2)))
            for size, x in spot.measured(facts, facts.noise_mm**-2.0)
        )
        if spots:
            yield Problem(
                make=in_a_part, starts=spots, steps=(0.3, *spot.STEPS), form=_IN_A_PART, price_nats=EFFECT_NATS
            )

    @property
    def hides(self) -> bool:
        """Which frames are disturbed; a camera that is always on hides nothing."""
        return self.probability < 1 or self.period_frames is not None

    def priors(self) -> dict[str, Prior]:
        """Those of the numbers that act."""
        if self.hides and self.period_frames is None:
            return Effect.priors(self)
        idle = ("burst_frames",) if self.hides else ("burst_frames", "probability")
        return {name: prior for name, prior in Effect.priors(self).items() if name not in idle}

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:
        """Refuse a map with values that are no parts."""
        Effect.check(self, sensor, surfaces)
        if self.map is not None and not ((self.map.values >= 0) & (self.map.values <= 1)).all():
            raise ValueError("map: every pixel needs a part of 0 to 1")

    def explain(self) -> str:
        """One sentence."""
        share = f"{100 * self.probability:g} % of the frames"
        when = (
            f"with a beat of {self.period_frames:g} frames, in {share}, most in their middle"
            if self.period_frames is not None
            else f"in {share}, in bursts of about {self.burst_frames:g}"
            if self.hides
            else "in all frames"
        )
        mapped = "" if self.map is None else f", times the part of each pixel from {self.map.path or 'a map'}"
        own = spot.of(self)
        where = "" if own is None else f", {spot.words_of(own)}"
        return f"a second camera adds noise of {self.sigma_mm:g} mm {when}{where}{mapped}"

    def prepare(self, context: Context, n_frames: int) -> BoolArray | FloatArray:
        """Whether each frame (frame,) is disturbed, or its overlap; the first are the same however many follow."""
        p = self.probability
        if p in (0.0, 1.0) and not (p and self.period_frames):
            return np.full(n_frames, p == 1.0)
        if self.period_frames is not None:
            return self._chain().overlap(np.arange(n_frames), context.recording_rng(self).random())
        stop = min(1 / self.burst_frames, (1 - p) / p)  # so that the chance to start is at most 1
        start = stop * p / (1 - p)
        states = np.empty(n_frames, dtype=np.bool_)
        disturbed = False
        for frame, u in enumerate(context.recording_rng(self).random(n_frames)):
            chance = p if frame == 0 else 1 - stop if disturbed else start
            disturbed = bool(u < chance)
            states[frame] = disturbed
        return states

    def truth(self, prepared: Any) -> tuple[EffectTruth, ...]:  # noqa: ANN401
        """Which frames were disturbed, or their overlap."""
        beats = prepared.dtype != np.bool_
        values = prepared.astype(np.float32 if beats else np.uint8)
        name = "part of its noise" if beats else "1 where disturbed"
        return (EffectTruth(name=self.kind, dims=("frame",), values=values, unit="1", long_name=name),)

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the whole noise."""
        self._add(echoes, context, 1.0)

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Disturb the frame by its part, if it is one of those."""
        part = float(context.prepared[context.frame])
        if part:
            self._add(samples, context, part)

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """Every surface's component splits in disturbed and quiet; with a beat, in several overlaps and quiet."""
        if not self.hides:
            self.act(prediction, context)
            return
        parts = [1.0] if self.period_frames is None else [(k + 0.5) / _SPLIT for k in range(_SPLIT)]
        lit = np.where(prediction.returned, self.probability / len(parts), 0.0)
        disturbed = []
        for part in parts:
            _, copy = prediction.split(lit)
            self._add(copy, context, part)
            disturbed.append(copy)
        quiet, _ = prediction.split(len(parts) * lit)
        for copy in disturbed:
            prediction.join(quiet, copy)
            quiet, _ = prediction.split(0.0)

    def _add(self, echoes: Echoes, context: Context, part: float) -> None:
        own = spot.of(self)
        sigma = self.sigma_mm * part
        light = 1.0 if own is None else spot.light_of(own, image_places(context.sensor.shape))
        added = sigma * light if self.map is None else sigma * light * self.map.values.ravel().astype(np.float64)
        echoes.sigma_mm = np.where(echoes.returned, np.hypot(echoes.sigma_mm, added), echoes.sigma_mm)

    def _chain(self) -> FrameChain:
        return FrameChain(self.probability, self.sigma_mm, self.burst_frames, self.period_frames or 0.0)
