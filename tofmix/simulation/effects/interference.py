"""A second camera that lights the scene in some frames."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tofmix.arrays import BoolArray
from tofmix.simulation.echoes import Echoes, FrameSamples
from tofmix.simulation.effects.base import Context, Effect, EffectTruth, Latent, Level, Target
from tofmix.simulation.effects.hidden import DisturbedFrames, HiddenState
from tofmix.simulation.effects.parameter import UniformPrior, about, number

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class Interference(Effect):
    """In bursts of frames, noise of `sigma_mm` is added in quadrature to every pixel that sees a surface.

    The light of a second camera has another phase: over one exposure it adds a phasor of random phase. The frame clocks
    of the cameras beat, so the disturbance comes in bursts. During a burst the noise is some cm to some ten cm (a
    foreign phasor of 10 % of the target's own changes the range by up to 120 mm at 20 MHz). A two-state Markov chain
    disturbs frames: bursts last `burst_frames` on average, and pauses have the length that gives the share
    `probability` of all frames. If pauses would be shorter than a frame, they last one frame and the bursts are longer.

    References
    ----------
    Buettgen and Seitz, Robust optical time-of-flight range imaging, IEEE Trans. Circuits and Systems I 55(6), 2008.
    """

    kind: ClassVar[str] = "interference"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "spread of the whole image in bursts of frames"
    typical: ClassVar[str] = "up to 120 mm at 20 MHz for a foreign phasor of 10 % of the target's own"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.SPREAD
    shows_in: ClassVar[tuple[str, ...]] = ("bursts", "common_mode", "spread")
    latent: ClassVar[Latent] = Latent.FRAME
    hidden: ClassVar[HiddenState | None] = DisturbedFrames(("probability", "sigma_mm", "burst_frames"))
    predicts: ClassVar[str] = (
        "exact for a single sample: a mixture of disturbed and quiet frames. A latent state of each frame disturbs"
        " all its pixels together, in bursts"
    )

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

    def explain(self) -> str:
        """One sentence."""
        return (
            f"a second camera adds noise of {self.sigma_mm:g} mm in {100 * self.probability:g} % of the frames, "
            f"in bursts of about {self.burst_frames:g}"
        )

    def prepare(self, context: Context, n_frames: int) -> BoolArray:
        """Whether each frame (frame,) is disturbed; the first frames are the same however many follow."""
        p = self.probability
        if p in (0.0, 1.0):
            return np.full(n_frames, p == 1.0)
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
        """Which frames were disturbed."""
        values = prepared.astype(np.uint8)
        return (EffectTruth(name=self.kind, dims=("frame",), values=values, unit="1", long_name="1 where disturbed"),)

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002
        """Add the noise."""
        echoes.sigma_mm = np.where(echoes.returned, np.hypot(echoes.sigma_mm, self.sigma_mm), echoes.sigma_mm)

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Disturb the frame if it is one of those."""
        if context.prepared[context.frame]:
            self.act(samples, context)

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """Every surface's component splits in disturbed and quiet."""
        quiet, disturbed = prediction.split(np.where(prediction.returned, self.probability, 0.0))
        self.act(disturbed, context)
        prediction.join(quiet, disturbed)
