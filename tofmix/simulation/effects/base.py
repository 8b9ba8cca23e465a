"""The base of effects: parameters, a level, and the action on samples and on predictions.

Write a new effect as a frozen dataclass over `Effect`, one file, and add its line
to `tofmix.simulation.effects`. Most effects need `act` alone: it changes
mean range, amplitude and sigma of `Echoes`, whether these are the samples of a
frame or the components of a prediction. Where chance decides sample by sample,
override `sample` and `predict` as well.
"""

import math
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.effects.hidden import HiddenState
from tofmix.simulation.effects.parameter import FARTHEST, Holds, Parameter, Prior, declared_parameters
from tofmix.simulation.surface import NEAREST_MM
from tofmix.toml_table import nearest

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction
    from tofmix.simulation.echoes import Echoes, FrameSamples
    from tofmix.simulation.surface import Surface

_RECORDING, _FRAME = 0, 1  # branches of an effect's random streams


class Level(IntEnum):
    """Place in the camera where an effect acts; levels act in this order."""

    GEOMETRY = 0
    LIGHT = 1
    CORRELATION = 2
    RANGE = 3
    READ_OUT = 4


LEVEL_NAMES = {
    Level.GEOMETRY: "geometry",
    Level.LIGHT: "light",
    Level.CORRELATION: "correlation",
    Level.RANGE: "range",
    Level.READ_OUT: "read-out",
}


class Target(Enum):
    """The part of the distribution of a pixel's samples that an effect changes most."""

    BIAS = "mean, the same at all times"
    TREND = "mean, changing in time"
    MIXTURE = "shares of several surfaces in one sample"
    SPREAD = "noise"
    VALUES = "values that a sample can have"
    LOSS = "probability of an invalid sample"


class Latent(Enum):
    """Hidden state that links the samples of an effect: given its parameters, they are not independent."""

    NONE = "none"
    FRAME = "a state of each frame"
    PIXEL = "a value of each pixel"
    MEMORY = "the noise of the frame before"
    STEP = "a quantisation step"


class Basic(Enum):
    """The errors that every model has; the one kind that describes each of them has one magnitude."""

    OFFSET = "one bias of all samples"
    POSE = "a surface at another place"
    NOISE = "one factor on all noise"
    FOLD = "a range axis that folds"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Context:
    """Camera, time and random streams that an effect uses.

    Parameters
    ----------
    sensor : CompleteCamera
        The camera.
    surfaces : tuple of str
        Names of the model's surfaces, in its order.
    seed : int
        The recording's seed.
    placed : tuple of Surface
        The model's surfaces where they stand at `time_s`, in its order; empty before the scene is known.
    frame : int
        The frame's number.
    time_s : float
        Start of the frame, s.
    prepared : object
        What the effect's `Effect.prepare` returned for this recording.
    expected : object
        What the effect's `Effect.expect` returned for this scene.
    part : int
        Number of the exposure within an averaged frame; 0 for a single sample.
    """

    sensor: CompleteCamera
    surfaces: tuple[str, ...]
    seed: int
    placed: "tuple[Surface, ...]" = ()
    frame: int = 0
    time_s: float = 0.0
    prepared: Any = None
    expected: Any = None
    part: int = 0

    @property
    def turn_mm(self) -> float:
        """d_u, the unambiguous range of the modulation, mm; NaN for a camera without phase."""
        return math.nan if self.sensor.modulation_frequency_hz is None else self.sensor.turn_mm("an effect")

    def number_of(self, surface: str) -> int:
        """Number of a surface in the model."""
        return self.surfaces.index(surface)

    def incidence(self, echoes: "Echoes") -> FloatArray:
        """Cosine of incidence of each echo, in its arrays' shape; 1 without a surface.

        The plane of a surface at distance h meets a beam at range r under a cosine of h / r.
        """
        distance = np.array([*(surface.plane_distance_mm for surface in self.placed), math.inf])
        cosine: FloatArray = np.minimum(distance[echoes.surface] / np.maximum(echoes.true_range_mm, NEAREST_MM), 1.0)
        return cosine

    def cosine(self) -> FloatArray:
        """Cosine (pixel,) of each pixel's angle off the axis, its direction's z: ``cos az cos el``."""
        s, optics = self.sensor, self.sensor.optics
        if not isinstance(optics, Equiangular):
            return beam_directions_of(optics, s.shape)[..., 2].ravel()
        azimuth = np.radians((np.arange(s.cols) - (s.cols - 1) / 2) * optics.fov_horizontal_deg / s.cols)
        elevation = np.radians((np.arange(s.rows) - (s.rows - 1) / 2) * optics.fov_vertical_deg / s.rows)
        cosine: FloatArray = np.outer(np.cos(elevation), np.cos(azimuth)).ravel()
        return cosine

    def corner_cosine(self) -> float:
        """Cosine of the angle off the axis of the pixel in the image's farthest corner."""
        image = self.cosine().reshape(self.sensor.shape)
        return float(image[[0, 0, -1, -1], [0, -1, 0, -1]].min())

    def recording_rng(self, effect: "Effect") -> np.random.Generator:
        """The effect's random stream of a recording, for draws that are constant over the frames."""
        return _stream(self.seed, effect, _RECORDING)

    def frame_rng(self, effect: "Effect") -> np.random.Generator:
        """The effect's own random stream of this frame."""
        return _stream(self.seed, effect, _FRAME, self.frame, self.part)


def _stream(seed: int, effect: "Effect", *key: int) -> np.random.Generator:
    """A separate stream for each kind and surface: a further effect changes no draw of the others."""
    name = zlib.crc32(f"{effect.kind} {getattr(effect, 'surface', '')}".encode())
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(name, *key))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EffectTruth:
    """A draw of an effect, as in ``truth/effects`` of a recording.

    Parameters
    ----------
    name : str
        Name of the dataset.
    dims : tuple of str
        ``("row", "col")`` or ``("frame",)``.
    values : array
        Of these dimensions.
    unit : str
        Unit; ``1`` without a dimension.
    long_name : str
        Description of the values.
    """

    name: str
    dims: tuple[str, ...]
    values: NDArray[np.generic]
    unit: str
    long_name: str


def truth_of_bias(kind: str, bias_mm: FloatArray) -> tuple[EffectTruth, ...]:
    """The draw of an effect that adds a bias (pixel,), mm, to each pixel."""
    values = bias_mm.astype(np.float32)
    return (EffectTruth(name=kind, dims=("row", "col"), values=values, unit="mm", long_name="bias of each pixel"),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """An effect of a real camera. Its fields are its parameters.

    Raises
    ------
    ValueError
        If a parameter is out of its bounds. The message names the key, the value and the bound.

    Attributes
    ----------
    kind : str
        Name in a model file.
    level : Level
        Level at which it acts.
    signature : str
        The statistic that shows it, and over which axis.
    typical : str
        Magnitudes of real cameras.
    basis : str
        Source of the magnitudes: ``physics`` (a formula that a test checks), ``reported`` (literature, recalled and not
        checked against a copy), or ``assumed``.
    predicts : str
        The part of its action on a pixel's distribution that has a closed form, and the approximation of the rest.
    target : Target
        Property of the distribution that it changes most.
    shows_in : tuple of str
        Statistics of `tofmix.reconciliation.comparison.panel` that it changes. It is never named for a deviation in
        other statistics. Empty for an exact law, which needs no such check.
    latent : Latent
        Hidden state that links its samples. `reconcile` searches for a kind without one by its parameters
        (`tofmix.simulation.effects.search`).
    hidden : HiddenState or None
        What this hidden state is, and which numbers describe it; None without one.
    basic : Basic or None
        Error of every model that it describes; of one kind each.
    exact_law : bool
        Whether cameras follow its law exactly. Then a single sample that fits exactly gains as much as many samples
        that fit roughly.
    changes_in_time : bool
        Whether the distribution of a pixel's samples depends on the time. `reconcile` then predicts it at several times
        of the recording.
    links_neighbours : bool
        Whether samples of neighbouring pixels depend on each other.
    loses_by_noise : bool
        Whether it loses samples by their amplitude. Amplitudes have noise, so `reconcile` uses `lose_by_noise`, after
        all other effects, in place of `predict`.
    acts_on_phase : bool
        Whether it needs a camera with a modulation frequency.
    averages : bool
        Whether a camera that averages on board can be simulated with it.
    magnitudes : tuple of str
        Numbers that are 0 together where the effect is absent; empty for the numbers that have a `zero`.
    separated_from : mapping of str to str
        For other kinds that one recording may not separate from it: a recording that does. Of two kinds one says it.
    remedy : str
        How a user measures or lessens it; empty for none. `reconcile` advises it where it names the kind.
    """

    kind: ClassVar[str]
    level: ClassVar[Level]
    signature: ClassVar[str]
    typical: ClassVar[str]
    basis: ClassVar[str]
    predicts: ClassVar[str] = "exact"
    target: ClassVar[Target]
    shows_in: ClassVar[tuple[str, ...]] = ()
    latent: ClassVar[Latent] = Latent.NONE
    hidden: ClassVar[HiddenState | None] = None
    basic: ClassVar[Basic | None] = None
    exact_law: ClassVar[bool] = False
    changes_in_time: ClassVar[bool] = False
    links_neighbours: ClassVar[bool] = False
    loses_by_noise: ClassVar[bool] = False
    acts_on_phase: ClassVar[bool] = False
    averages: ClassVar[bool] = True
    magnitudes: ClassVar[tuple[str, ...]] = ()
    separated_from: ClassVar[Mapping[str, str]] = {}
    remedy: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for parameter in self.parameters().values():
            if refusal := parameter.refusal(getattr(self, parameter.name)):
                raise ValueError(refusal)

    @classmethod
    def parameters(cls) -> Mapping[str, Parameter]:
        """The declared parameters by name."""
        return {parameter.name: parameter for parameter in declared_parameters(cls)}

    def is_basic(self, error: Basic) -> bool:
        """Whether it describes an error that every model may have."""
        return type(self).basic is error

    @classmethod
    def of_magnitude(cls, value: float, surface: str = "") -> "Effect":
        """The effect of this magnitude, its first number that is nothing somewhere; of a surface if it acts on one.

        Raises
        ------
        ValueError
            If the value is out of bounds.
        """
        numbers: dict[str, Any] = {cls._magnitude(): value} | ({"surface": surface} if surface else {})
        return cls(**numbers)

    @classmethod
    def _magnitude(cls) -> str:
        return next(p.name for p in cls.parameters().values() if p.zero is not None)

    @classmethod
    def tilted(cls, surface: "Surface", shift_mm: float, tilts_deg: tuple[float, float] = (0.0, 0.0)) -> "Effect":
        """The effect that shifts a surface along its normal, mm, and tilts it about its own axes, if it is a pose."""
        raise NotImplementedError

    def in_affected(self) -> "Effect":
        """The effect in an affected pixel, as one of all pixels; of those with `AffectedPixels` only.

        It has the same kind: a model has an effect of each kind once.
        """
        raise NotImplementedError

    @property
    def surfaces(self) -> dict[str, str]:
        """Names of the surfaces that it names, by parameter."""
        named = {name: getattr(self, name) for name, p in self.parameters().items() if p.holds is Holds.SURFACE}
        return {name: value for name, value in named.items() if value}

    @property
    def hides(self) -> bool:
        """Whether the samples have its hidden state; not where its numbers leave nothing open."""
        return self.latent is not Latent.NONE

    @property
    def warm_up_s(self) -> float | None:
        """Time constant of the camera's temperature, s, if the effect follows from it; None otherwise."""
        return None

    def amplitude_factor(self, turn_mm: float) -> float | None:  # noqa: ARG002  for those of one surface's light
        """Factor on the amplitudes of its surface, if it acts on the light of one surface alone; None otherwise."""
        return None

    def least_errors(self, amplitude: FloatArray) -> dict[str, float]:  # noqa: ARG002  for those of a threshold
        """Least standard error of numbers that no curvature shows, by the amplitudes (n,) that the scene has."""
        return {}

    def size_of_map(self) -> str:
        """The size of its map in words; empty without one."""
        return ""

    @property
    def outlier_share(self) -> float:
        """Share of the samples that the effect replaces by random values."""
        return 0.0

    @classmethod
    def places_in_time(cls) -> bool:
        """Whether it places surfaces, elsewhere at each time."""
        return cls.level is Level.GEOMETRY and cls.changes_in_time

    @property
    def moves(self) -> bool:
        """Whether the scene changes with time."""
        return False

    def explain(self) -> str:
        """The action of the effect with its values, in one sentence."""
        raise NotImplementedError

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:
        """Refuse an effect that does not fit the camera or the scene.

        Raises
        ------
        ValueError
            The message begins with the key.
        """
        if self.acts_on_phase:
            refuse_without_phase(self.kind, sensor)
        for parameter in self.parameters().values():
            name = getattr(self, parameter.name)
            may_be_all = name == "" and not parameter.required
            if parameter.holds is Holds.SURFACE and not may_be_all and name not in surfaces:
                raise ValueError(f'{parameter.key}: "{name}" is not a surface of this model{nearest(name, surfaces)}')
        plane = getattr(self, "map", None)
        if plane is not None and plane.values.shape != (sensor.rows, sensor.cols):
            raise ValueError(f"map: shape {plane.values.shape} differs from the image {(sensor.rows, sensor.cols)}")

    def numbers(self) -> dict[str, float]:
        """Its numbers by name: the parameters that are one, and those within parameters that hold several."""
        values = {name: getattr(self, name) for name in self.parameters()}
        return {name: float(v) for name, v in values.items() if isinstance(v, int | float)}

    def priors(self) -> dict[str, Prior]:
        """The prior density of each number that has one, given the other numbers; for `reconcile`."""
        declared, own = self.parameters(), self.numbers()
        return {name: prior for name, p in declared.items() if (prior := p.prior) is not None and name in own}

    def log_prior(self) -> float:
        """Log of the prior density of the numbers, each in its unit; minus infinity where no camera has them."""
        own = self.numbers()
        return sum(prior.log_density(own[name]) for name, prior in self.priors().items())

    def plausible(self) -> bool:
        """Whether a real camera can have these numbers; if not, they are the trace of another cause."""
        own = self.numbers()
        return all(prior.deviate(own[name]) <= FARTHEST for name, prior in self.priors().items())

    def frame_bias(self, time_s: FloatArray) -> FloatArray | None:  # noqa: ARG002  for those that are one
        """Bias (frame,) of all lit samples of the frames at some times, mm, if the effect is nothing else; or None."""
        return None

    def place(self, surface: "Surface", time_s: float) -> "Surface":  # noqa: ARG002  for those that move one
        """A surface at a time. Geometry effects only."""
        return surface

    def prepare(self, context: Context, n_frames: int) -> Any:  # noqa: ANN401, ARG002  the effect's own
        """Draw the values that hold for a whole recording of `n_frames`; `context.prepared` returns them."""
        return None

    def truth(self, prepared: Any) -> tuple[EffectTruth, ...]:  # noqa: ANN401, ARG002  the effect's own
        """Draws of `prepare`, for the recording's truth."""
        return ()

    def expect(self, prediction: "Prediction", context: Context) -> Any:  # noqa: ANN401, ARG002  the effect's own
        """Compute the data of the whole scene for a light effect; `context.expected` returns them.

        `prediction` has the light effects before this one applied.
        """
        return None

    def lose_by_noise(self, prediction: "Prediction") -> None:
        """As `predict`, of amplitudes that have the noise of a sample."""
        raise NotImplementedError

    def act(self, echoes: "Echoes", context: Context) -> None:
        """Change echoes in place: the samples of a frame, or the components of a prediction."""
        raise NotImplementedError

    def colour(self, noise: FloatArray, before: FloatArray) -> FloatArray:  # noqa: ARG002  for those that remember
        """A frame's standardised noise (pixel,), given that of the frame before."""
        return noise

    def sample(self, samples: "FrameSamples", context: Context) -> None:
        """Change one frame's samples in place."""
        self.act(samples, context)

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """Change a prediction in place."""
        self.act(prediction, context)


_Hidden = TypeVar("_Hidden", bound=HiddenState)


def with_hidden(effects: Iterable[Effect], sort: type[_Hidden]) -> Iterator[tuple[Effect, _Hidden]]:
    """The effects with a hidden state of this sort, each with its declaration."""
    for effect in effects:
        if effect.hides and isinstance(effect.hidden, sort):
            yield effect, effect.hidden


def refuse_without_phase(kind: str, sensor: CompleteCamera) -> None:
    """Raise ValueError, a message that begins with the key, if the camera has no modulation frequency."""
    if sensor.modulation_frequency_hz is None:
        raise ValueError(f"kind: {kind} acts on the phase, and {sensor.name} has no modulation_frequency_hz")
