"""Several recordings of one camera: their common parts, and the parts of each one's scene.

Effects of the camera act in all recordings with the same parameters; so do the biases and values of pixels. Effects of
a surface act in recordings with this surface. Two surfaces are the same if name, position, size and reflectivity are
equal in both models. Otherwise they have different names during the search (`tell_apart`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from tofmix.errors import BadInputError
from tofmix.reconciliation.evidence import Evidence, join
from tofmix.reconciliation.likelihood.likelihood import Likelihood, Part
from tofmix.reconciliation.likelihood.mixture import Mixture, Scene, Scenes
from tofmix.reconciliation.likelihood.side_information import (
    SideInformation,
    amplitude_information,
    as_bright_as_seen,
    log_ratios,
    warm_up_information,
)
from tofmix.simulation.effects.base import Effect
from tofmix.simulation.model import Model

if TYPE_CHECKING:
    from tofmix.simulation.surface import Surface

Recording = tuple[Model, Evidence]
"""A model and the samples of its recording."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingView:
    """One recording of a likelihood.

    Parameters
    ----------
    number : int
        Its number, from 0.
    frames : slice
        Its frames among those of all recordings.
    scene, evidence, mixture
        Those of the recording.
    part : (frames, pixels)
        The part of it, by the numbers of its own frames.
    """

    number: int
    frames: slice
    scene: Scene
    evidence: Evidence
    mixture: Mixture
    part: Part

    @property
    def part_of_all(self) -> Part:
        """The part, by the numbers of frames among those of all recordings."""
        return self.part[0] + self.frames.start, self.part[1]


def views(likelihood: Likelihood, mixture: Mixture, part: Part) -> Iterator[RecordingView]:
    """Each recording with frames in the part."""
    evidence = likelihood.evidence
    for number, (frames, scene) in enumerate(zip(evidence.recordings, likelihood.scene.members, strict=True)):
        own = part[0][(part[0] >= frames.start) & (part[0] < frames.stop)] - frames.start
        if own.size:
            yield RecordingView(
                number=number,
                frames=frames,
                scene=scene,
                evidence=evidence.recording(frames),
                mixture=mixture.of_frames(frames),
                part=(own, part[1]),
            )


def joint_likelihood(recordings: Sequence[Recording]) -> Likelihood:
    """The likelihood of recordings of one camera.

    Parameters
    ----------
    recordings : sequence of (Model, Evidence)
        At least one.

    Raises
    ------
    BadInputError
        If the models' cameras differ.
    """
    check_camera([model for model, _ in recordings])
    models = tell_apart([model for model, _ in recordings])
    alone = [evidence for _, evidence in recordings]
    scenes: list[Scene] = []
    side_information: dict[str, SideInformation] = {}
    for model, evidence in zip(models, alone, strict=True):
        scene, side = _seen(model, evidence)
        scenes.append(scene)
        side_information |= {name: w for name, w in side.items() if name not in side_information}
    joined = scenes[0] if len(scenes) == 1 else Scenes(tuple(scenes))
    return Likelihood(join(alone), joined, tuple(side_information.values()))


def _seen(model: Model, evidence: Evidence) -> tuple[Scene, dict[str, SideInformation]]:
    """The scene with recorded amplitudes, and the observations of amplitudes and temperatures by name."""
    scene = Scene(model, evidence.time_s)
    ratios = log_ratios(model, evidence, scene.mixture())
    side: dict[str, SideInformation] = {}
    if model.sensor.modulation_frequency_hz is not None:
        side |= {
            f"amplitude of {w.surface}": w for w in amplitude_information(ratios, model.sensor.turn_mm("reconcile"))
        }
    warm_up = warm_up_information(evidence)
    if warm_up is not None:
        side["temperature"] = warm_up
    bright = as_bright_as_seen(model, ratios)
    return (scene if bright is model else Scene(bright, evidence.time_s)), side


def check_camera(models: Sequence[Model]) -> None:
    """Refuse models of different cameras. The integration time may differ.

    Raises
    ------
    BadInputError
        Naming the first key that differs.
    """
    first = models[0].sensor
    for model in models[1:]:
        for field in fields(first):
            ours, theirs = getattr(first, field.name), getattr(model.sensor, field.name)
            if field.name in _MAY_DIFFER or ours == theirs:
                continue
            if field.name == "noise":
                if ours.same_as(theirs):
                    continue
                raise BadInputError("sensor: noise: another camera than the first model's: the noise curves differ")
            raise BadInputError(
                f"sensor: {field.name}: {theirs} is another camera than the first model's {ours}; --also takes"
                " recordings of one camera: reconcile this one by itself"
            )


_MAY_DIFFER = ("name", "integration_time_ms", "default_integration_time_ms", "confirmed", "sources")


def tell_apart(models: Sequence[Model]) -> list[Model]:
    """The models; a surface is renamed if a different surface of another recording has its name."""
    known: dict[str, Surface] = {}
    out = []
    for number, model in enumerate(models, 1):
        names = {s.name: s.name if known.get(s.name, s) == s else f"{s.name} ({number})" for s in model.surfaces}
        surfaces = tuple(replace(s, name=names[s.name]) for s in model.surfaces)
        effects = tuple(renamed(effect, names) for effect in model.effects)
        out.append(replace(model, surfaces=surfaces, effects=effects))
        known |= {s.name: s for s in surfaces}
    return out


def renamed(effect: Effect, names: dict[str, str]) -> Effect:
    """The effect with the new names of its surfaces, if it has any."""
    new: Any = {key: names[name] for key, name in effect.surfaces.items() if names[name] != name}
    return replace(effect, **new) if new else effect
