"""Draws the cases: a model as a user has it, and the truth that is recorded, by `tofmix simulate` itself.

Case k of a seed is the same however many are drawn.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.sensors import load_profile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import EFFECTS, Effect, PixelMap
from tofmix.simulation.effects.base import Context
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.exposure import predict
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.render import render_blocks
from tofmix.simulation.surface import Surface
from users.rooms import ROOMS
from users.strangers import STRANGERS, Stranger

ROWS, COLS, FRAMES, RATE_HZ = 56, 72, 120, 25.0
SENSORS = ("sr3000", "sr4000")
TURNED_DEG, MOVED_MM = 2.0, 40.0
LEAST_SEEN = 100
"""Least pixels of a surface that is moved, moves or is lit by another one."""
_MAKE: Mapping[str, Callable[..., Effect]] = EFFECTS
_PERIOD = 12  # cases in which each sort comes as often as it shall
_PLAIN, _STRANGE = 10, 11  # of a period: without effects or nearly right; a stranger


def _surface(name: str, center: tuple[float, float, float], size: tuple[float, float], *more: float) -> Surface:
    reflectivity, yaw, pitch = (*more, 0.0, 0.0)[:3]
    return Surface(name=name, center_mm=center, size_mm=size, reflectivity=reflectivity, yaw_deg=yaw, pitch_deg=pitch)


SCENES: dict[str, tuple[Surface, ...]] = {
    "wall": (_surface("wall", (0, 0, 2200), (5200, 4200), 0.7),),
    "slanted": (_surface("wall", (0, 0, 3000), (9000, 7000), 0.7, 35.0),),
    "wall and box": (
        _surface("wall", (0, 0, 2000), (4000, 3000), 0.7),
        _surface("box", (100, 150, 1200), (400, 300), 0.5),
    ),
    "two boards": (
        _surface("back", (300, 0, 3500), (3600, 3000), 0.9, 5.0),
        _surface("front", (-500, 100, 1500), (900, 900), 0.4, -10.0, 5.0),
    ),
    "corner": (
        _surface("left", (-1100, 0, 2400), (3600, 3600), 0.8, 50.0),
        _surface("right", (1100, 0, 2400), (3600, 3600), 0.6, -50.0),
    ),
    "steps": (
        _surface("near", (-900, 0, 1400), (800, 2400), 0.3),
        _surface("middle", (-150, 0, 2300), (900, 2600), 0.8),
        _surface("far", (0, 0, 3600), (5200, 4200), 0.6),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A model and a truth."""

    name: str
    """Number, scene and what is hidden."""
    scene: str
    """A key of `SCENES` or of `ROOMS`."""
    sort: str
    """``effects``, ``pose``, ``none``, ``nearly`` or ``stranger``."""
    given: Model
    true: Model
    """`given`, `true`: as the user has it; as it is recorded."""
    hidden: tuple[Effect, ...]
    """What the given model lacks; of a moved surface, the effect that moves it."""
    seed: int
    """Of the recording."""
    stranger: Stranger | None = None
    """What changes the samples afterwards."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of what is hidden, sorted."""
        return tuple(sorted(e.kind for e in self.hidden))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _uniform(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(rng.uniform(low, high))


def _either(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(rng.uniform(low, high)) * _sign(rng)


_Drawn = Mapping[str, Any]
MAGNITUDES: dict[str, _Drawn] = {
    "range_offset": {"offset_mm": _either(6, 25)},
    "surface_pose": {"shift_mm": _either(12, 30)},
    "wiggling": {"amplitude_mm": _uniform(6, 20), "phase_rad": _uniform(-math.pi, math.pi)},
    "amplitude_walk": {"scale_mm": _either(15, 40), "reference_amplitude": 100.0, "exponent": 1.0},
    "temperature_drift": {"amplitude_mm": _uniform(10, 25), "time_constant_s": _uniform(0.8, 2.5)},
    "scattering": {"share": _uniform(0.012, 0.04)},
    "multipath": {"share": _uniform(0.05, 0.12), "extra_path_mm": _uniform(500, 1400)},
    "internal_reflection": {"amplitude": _uniform(4, 12), "range_mm": _uniform(0, 150)},
    "near_return": {"share": _uniform(0.02, 0.1), "range_mm": _uniform(15, 60), "sigma_mm": _uniform(3, 8)},
    "excess_noise": {"factor": _uniform(1.15, 1.6)},
    "outliers": {"probability": _uniform(0.006, 0.03)},
    "temporal_correlation": {"coefficient": _uniform(0.15, 0.5)},
    "interference": {"probability": _uniform(0.1, 0.2), "sigma_mm": _uniform(60, 140), "burst_frames": 5.0},
    "motion": {"velocity_mm_s": _either(6, 15)},
    "quantisation": {"step_mm": _uniform(20, 60)},
    "pixel_crosstalk": {"share": _uniform(0.02, 0.05)},
    "vignetting": {"corner_factor": _uniform(1.3, 2.2)},
    "fixed_pattern": {
        "pixel_sigma_mm": _uniform(6, 15),
        "column_sigma_mm": _uniform(4, 10),
        "row_sigma_mm": _uniform(4, 10),
    },
}
"""How large each kind is, drawn uniformly."""

_OF_A_SURFACE = ("surface_pose", "multipath", "motion")
_LEAST_BURSTS = 3


def draw(seed: int, number: int, scenes: str = "boards") -> Case:
    """Case `number` of a seed, from 0; `scenes` are ``boards``, those of `SCENES`, or ``rooms``, drawn anew."""
    rng = np.random.default_rng([seed, number])
    if scenes == "boards":
        scene = list(SCENES)[int(rng.integers(len(SCENES)))]
        surfaces = SCENES[scene]
    else:
        scene = list(ROOMS)[int(rng.integers(len(ROOMS)))]
        surfaces = ROOMS[scene](rng)
    given = Model(
        sensor=replace(load_profile(str(rng.choice(SENSORS))), rows=ROWS, cols=COLS),
        surfaces=surfaces,
        recording=RecordingSettings(frames=FRAMES, frame_rate_hz=RATE_HZ),
    )
    at = number % _PERIOD
    recorded = int(rng.integers(1, 2**31))
    if at == _STRANGE:
        stranger = STRANGERS[int(rng.integers(len(STRANGERS)))]
        return _case(number, scene, "stranger", given, given, (), recorded, stranger)
    if at == _PLAIN:
        nearly = bool(rng.integers(2))
        true = _nearly(given, rng) if nearly else given
        return _case(number, scene, "nearly" if nearly else "none", given, true, (), recorded)
    counted = number // _PERIOD * _PLAIN + at  # of the cases with effects
    if counted % 10 == 9:
        return _moved(number, scene, given, rng, recorded)
    count = (1, 2, 2, 2, 3)[counted % 5]
    while True:
        hidden = _effects(rng, given, count)
        true = replace(given, effects=hidden)
        if _enough_bursts(true, recorded):
            return _case(number, scene, "effects", given, true, hidden, recorded)
        recorded = int(rng.integers(1, 2**31))


def _case(
    number: int,
    scene: str,
    sort: str,
    given: Model,
    true: Model,
    hidden: tuple[Effect, ...],
    seed: int,
    stranger: Stranger | None = None,
) -> Case:
    what = "+".join(sorted(e.kind for e in hidden)) or (sort if stranger is None else stranger.name)
    return Case(
        name=f"{number:03d} {scene}: {what}",
        scene=scene,
        sort=sort,
        given=given,
        true=true,
        hidden=hidden,
        seed=seed,
        stranger=stranger,
    )


def _effects(rng: np.random.Generator, model: Model, count: int) -> tuple[Effect, ...]:
    kinds = [k for k in MAGNITUDES if k != "multipath" or len(model.surfaces) > 1]
    chosen = [kinds[k] for k in rng.choice(len(kinds), size=count, replace=False)]
    return tuple(_effect(rng, kind, model) for kind in chosen)


def _effect(rng: np.random.Generator, kind: str, model: Model) -> Effect:
    values = {name: drawn(rng) if callable(drawn) else drawn for name, drawn in MAGNITUDES[kind].items()}
    if kind in _OF_A_SURFACE:
        seen = _seen(model)
        values["surface"] = seen[int(rng.integers(len(seen)))].name
    return _MAKE[kind](**values)


def _enough_bursts(model: Model, seed: int) -> bool:
    """Whether a second camera disturbs at least three times, if there is one."""
    if not any(e.kind == "interference" for e in model.effects):
        return True
    quiet = replace(model, effects=tuple(e for e in model.effects if e.kind == "interference"))
    small = replace(quiet, sensor=replace(quiet.sensor, rows=4, cols=4))
    samples = record(small, seed).astype(np.float64)
    spread = np.nanstd(samples - np.nanmedian(samples, axis=0), axis=(1, 2))
    loud = spread > 1.5 * np.median(spread)  # half of the least that is drawn, on the noisiest scene
    return int((np.diff(loud.astype(int), prepend=0) == 1).sum()) >= _LEAST_BURSTS


def _moved(number: int, scene: str, given: Model, rng: np.random.Generator, seed: int) -> Case:
    """A surface that stands elsewhere and is turned, by a changed surface and not by an effect."""
    seen = _seen(given)
    surface = seen[int(rng.integers(len(seen)))]
    angle = rng.uniform(0, 2 * math.pi)
    shift, first, second = MOVED_MM * _sign(rng), TURNED_DEG * math.cos(angle), TURNED_DEG * math.sin(angle)
    if scene in SCENES:
        effect = SurfacePose(surface=surface.name, shift_mm=shift, yaw_deg=first, pitch_deg=second)
    else:  # of a side wall or a floor some of the angles are no tilt
        effect = SurfacePose.tilted(surface, shift, (second, first))
    surfaces = tuple(effect.place(s, 0.0) for s in given.surfaces)
    return _case(number, scene, "pose", given, replace(given, surfaces=surfaces), (effect,), seed)


def _seen(model: Model) -> list[Surface]:
    """Surfaces that are the main one of some pixels; all of `SCENES` are."""
    truth = cast_scene(model)
    most = np.nanargmax(np.nan_to_num(truth.weight_true, nan=0.0), axis=2)[..., None]
    main = np.take_along_axis(truth.surface, most, axis=2)
    return [s for number, s in enumerate(model.surfaces) if (main == number).sum() >= LEAST_SEEN]


def _nearly(given: Model, rng: np.random.Generator) -> Model:
    """A model that is nearly right: ranges by poses to 0.1 sigma, noise to 1 %, reflectivities to 5 %."""
    surfaces = []
    for s, sigma in zip(given.surfaces, _sigma_of_place(given), strict=True):
        shift = 0.1 * sigma * _sign(rng)
        x, y, z = np.array(s.center_mm) + shift * s.rotation()[:, 2]
        reflectivity = min(s.reflectivity * (1 + 0.05 * _sign(rng)), 1.0)
        surfaces.append(replace(s, center_mm=(float(x), float(y), float(z)), reflectivity=reflectivity))
    return replace(given, surfaces=tuple(surfaces), effects=(_MAKE["excess_noise"](factor=1 + 0.01 * _sign(rng)),))


def _sigma_of_place(given: Model) -> list[float]:
    """Of each surface the move along its normal, mm, that moves its ranges by their sigma, in the median pixel.

    The camera need not see a surface's centre, nor the foot of its plane, as in the corner.
    """
    seen = predict(given, cast_scene(given))
    main = seen.weight.argmax(axis=0)[None]
    surface, sigma, ranges = (
        np.take_along_axis(of, main, axis=0)[0] for of in (seen.surface, seen.sigma_mm, seen.true_range_mm)
    )
    own = [surface == number for number in range(len(given.surfaces))]
    planes = [abs(float(s.rotation()[:, 2] @ np.array(s.center_mm))) for s in given.surfaces]
    return [
        float(np.median(sigma[o] / ranges[o])) * plane if o.any() else 0.0 for o, plane in zip(own, planes, strict=True)
    ]


def record(model: Model, seed: int) -> Float32Array:
    """A recording (frame, row, col) of a model, mm, NaN where invalid."""
    frames = model.recording.frames
    (block,) = render_blocks(model, cast_scene(model), n_frames=frames, seed=seed, block_frames=frames)
    return np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)


def same_camera(model: Model, seed: int) -> Model:
    """The model with each pixel's own bias as a recording of some seed has it, whatever the seed of the next one."""
    context = Context(sensor=model.sensor, surfaces=tuple(s.name for s in model.surfaces), seed=seed)

    def known(effect: Effect) -> Effect:
        if not isinstance(effect, FixedPattern):
            return effect
        bias = effect.prepare(context, model.recording.frames).reshape(model.sensor.shape)
        return replace(effect, map=PixelMap("", bias.astype(np.float32)))

    return replace(model, effects=tuple(known(e) for e in model.effects))


def recorded(case: Case, seed: int | None = None) -> Float32Array:
    """A recording (frame, row, col) of a case, mm, NaN where invalid; its own, or another of another seed."""
    own = case.seed if seed is None else seed
    samples = record(case.true if seed is None else same_camera(case.true, case.seed), own)
    return samples if case.stranger is None else case.stranger.change(samples, np.random.default_rng([own, 7]))
