"""The list of cases, and how one is built: a pure function of its name and the half's master seed.

A case's name says what it is (`wiggling-clear-2-4`: kind, level, scene slot, seed; `pinhole-wiggling-clear-1`: setting,
kind, level, number), and `build` draws everything else. Settings other than the ordinary one draw from random streams
of their own, so that ordinary cases do not change by them.
Half of the names belong to the open half, half to the sealed one.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from blind.calibrate import calibrated
from blind.camera import STANDARD_GLOSS, Device, Mechanism, Recording, record
from blind.effects import Effect, Place, SecondCamera
from blind.eligible import CLOSED, EVERY, FAMILIES, ROOM_LIGHT
from blind.eligible import MISSING_OBJECT as MISSING_OBJECT_FAMILIES
from blind.geometry import Array, Lens, Surface, cast
from blind.reference import NoiseTable
from blind.scenes import draw_scene, with_object
from blind.strangers import MISSING_OBJECT, MISSING_OBJECT_AXES, STRANGERS, make_stranger
from blind.strength import KINDS, make

OPEN_SEED = 20080922
SETTINGS = ("room_light", "pinhole", MISSING_OBJECT)
OF_EACH = 4  # cases of a kind and setting
NONE_OF_EACH = 8  # without an effect
OBJECTS = 12
DEVICES = 10
PAIRS: tuple[tuple[str, str], ...] = (
    ("wiggling", "temperature_drift"),
    ("range_offset", "excess_noise"),
    ("wiggling", "stuck_pixels"),
    ("scattering", "dropout"),
    ("amplitude_walk", "temporal_correlation"),
    ("surface_pose", "vignetting"),
    ("multipath", "interference"),
    ("fixed_pattern", "temperature_drift"),
    ("flying_pixels", "excess_noise"),
    ("pixel_crosstalk", "outliers"),
    ("saturation", "wiggling"),
    ("motion", "outliers"),
    ("quantisation", "range_offset"),
    ("phase_wrapping", "excess_noise"),
    ("temporal_correlation", "dropout"),
    ("interference", "vignetting"),
    ("fixed_pattern", "wiggling"),
    ("surface_pose", "temperature_drift"),
    ("multipath", "stuck_pixels"),
    ("scattering", "temporal_correlation"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One recording with something hidden in it, or nothing."""

    name: str
    sort: str  # single, pair, none, nearly, stranger
    kinds: tuple[str, ...]
    level: str
    slot: int
    seed: int
    half: str
    setting: str = "ordinary"  # or one of SETTINGS


@dataclass(frozen=True, slots=True, kw_only=True)
class Built:
    """A case with everything drawn."""

    case: Case
    device: Device
    noise: NoiseTable  # as the model file has it
    scenes: tuple[list[Surface], list[Surface]]  # as they are, first and second
    models: tuple[list[Surface], list[Surface]]  # as the model files have them
    families: tuple[str, str]
    mechanisms: tuple[Mechanism, ...]
    seeds: tuple[int, ...]  # of the recordings, below

    def record(self, which: int = 0, *, ideal: bool = False) -> Recording:
        """Record: 0 what reconcile gets, 1 the second scene; 2 and 3 the first scene again, 4 and 5 the second.

        `ideal`: without effects.
        """
        scene = self.scenes[1 if which in (1, 4, 5) else 0]
        return record(self.device, scene, () if ideal else self.mechanisms, seed=self.seeds[which])

    def place(self, which: int = 0) -> Place:
        """Where its mechanisms act."""
        surfaces = self.scenes[which]
        return Place(device=self.device, surfaces=surfaces, beams=cast(surfaces, self.device.view))

    def truth(self) -> dict[str, Any]:
        """What is hidden, physically and in the model files' terms."""
        place = self.place()
        effects: list[dict[str, Any]] = [
            {"kind": m.kind, "mechanism": type(m).__name__, "physical": m.physical(), "parameters": m.equivalent(place)}
            for m in self.mechanisms
            if isinstance(m, Effect)
        ]
        out: dict[str, Any] = {
            "case": self.case.name,
            "sort": self.case.sort,
            "level": self.case.level,
            "half": self.case.half,
            "kinds": list(self.case.kinds),
            "effects": effects,
            "scenes": list(self.families),
        }
        if self.case.setting != "ordinary":
            out["setting"] = self.case.setting
        for effect, mechanism in zip(effects, self.mechanisms, strict=False):
            if isinstance(mechanism, SecondCamera):  # few bursts: what came, not what was to be expected
                effect["parameters"]["probability"] = float(mechanism.bursts(self.device.frames, self.seeds[0]).mean())
        if self.case.setting == MISSING_OBJECT:
            out["stranger"] = {"name": MISSING_OBJECT, "axes": list(MISSING_OBJECT_AXES), "size": self._object_share()}
            out["kinds"] = []
        elif self.case.sort == "stranger":
            (stranger,) = self.mechanisms
            out["stranger"] = {
                "name": self.case.kinds[0],
                "axes": list(getattr(stranger, "axes", ())),
                "size": getattr(stranger, "size", 0.0),
            }
            out["kinds"] = []
        return out

    def _object_share(self) -> float:
        """Share of the image that the object fills which the model lacks."""
        beams = self.place().beams
        return float((beams.share * (beams.surface == len(self.scenes[0]) - 1)).sum() / self.device.view.pixels)

    def maps(self) -> dict[str, Array]:
        """The device's own maps (row, col) by kind."""
        found = {m.kind: m.map(self.device) for m in self.mechanisms if isinstance(m, Effect)}
        return {kind: values for kind, values in found.items() if values is not None}


def _half(number: int) -> str:
    return "open" if number % 2 == 0 else "sealed"


def all_cases() -> list[Case]:
    """Every case of both halves, in a fixed order."""
    out = []
    for kind in KINDS:
        for level in ("faint", "clear"):
            for slot in range(3):
                for seed in range(5):
                    name = f"{kind}-{level}-{slot}-{seed}"
                    half = _half(slot * 5 + seed + (level == "faint"))
                    out.append(
                        Case(name=name, sort="single", kinds=(kind,), level=level, slot=slot, seed=seed, half=half)
                    )
    for k, pair in enumerate(PAIRS):
        out.append(Case(name=f"pair-{k}", sort="pair", kinds=pair, level="clear", slot=k, seed=k, half=_half(k)))
    out += [
        Case(name=f"{sort}-{k}", sort=sort, kinds=(), level="", slot=k, seed=k, half=_half(k))
        for sort in ("none", "nearly")
        for k in range(30)
    ]
    out += [
        Case(name=f"{name}-{k}", sort="stranger", kinds=(name,), level="clear", slot=k, seed=k, half=_half(k))
        for name in STRANGERS
        for k in range(4)
    ]
    return out + _other_settings()


def _other_settings() -> list[Case]:
    """Clear effects and none under room light and behind a lens, and objects that the model lacks."""
    out = []
    for setting, eligible in (("room_light", ROOM_LIGHT), ("pinhole", FAMILIES)):
        out += [
            Case(
                name=f"{setting}-{kind}-clear-{k}",
                sort="single",
                kinds=(kind,),
                level="clear",
                slot=k,
                seed=k,
                half=_half(k),
                setting=setting,
            )
            for kind in KINDS
            if kind in eligible
            for k in range(OF_EACH)
        ]
        out += [
            Case(
                name=f"{setting}-none-{k}",
                sort="none",
                kinds=(),
                level="",
                slot=k,
                seed=k,
                half=_half(k),
                setting=setting,
            )
            for k in range(NONE_OF_EACH)
        ]
    out += [
        Case(
            name=f"{MISSING_OBJECT}-{k}",
            sort="stranger",
            kinds=(MISSING_OBJECT,),
            level="clear",
            slot=k,
            seed=k,
            half=_half(k),
            setting=MISSING_OBJECT,
        )
        for k in range(OBJECTS)
    ]
    return out


@lru_cache(maxsize=1)
def strengths() -> dict[str, dict[str, float]]:
    """`found`, `faint` and `clear` of each kind."""
    table: dict[str, dict[str, float]] = tomllib.loads((Path(__file__).parent / "strengths.toml").read_text())
    return table


def draw_device(master: int, number: int, *, far: bool = False) -> Device:
    """One of the cameras of a half."""
    rng = np.random.default_rng([master, number, int(far), 31])
    rows, cols = [(48, 64), (56, 72), (64, 80)][number % 3]
    return Device(
        name=f"camera {number + 1}",
        rows=rows,
        cols=cols,
        fov_horizontal_deg=round(float(rng.uniform(56, 62)), 2),
        fov_vertical_deg=round(float(rng.uniform(44, 50)), 2),
        frequency_hz=float(rng.choice([19.0e6, 20.0e6, 21.0e6])),
        integration_time_ms=float(rng.choice([0.8, 1.2, 2.0])),
        frame_rate_hz=float(rng.choice([15.0, 25.0, 30.0])),
        frames=int(rng.choice([200, 250, 300])),
        range_min_mm=300.0,
        range_max_mm=11200.0 if far else 7200.0,
        noise_linear=round(float(rng.uniform(1.5, 2.5)), 3),
        noise_square=round(float(rng.uniform(0.8, 1.0) if far else rng.uniform(1.1, 1.8)), 3),
    )


def _families(case: Case, rng: np.random.Generator) -> tuple[str, str]:
    """First and second scene: families on which all kinds can be told apart."""
    if "phase_wrapping" in case.kinds:
        return "far_gate" if case.level == "faint" else "far_hall", "far_hall"
    static = case.kinds[:1] in (("other_period",), ("kink",), ("dark_noise",))
    fit: tuple[str, ...] = CLOSED if static else EVERY
    if case.setting == "room_light":
        fit = ROOM_LIGHT[case.kinds[0]] if case.kinds else ROOM_LIGHT["outliers"]
    elif case.setting == MISSING_OBJECT:
        fit = MISSING_OBJECT_FAMILIES
    else:
        for kind in case.kinds:
            fit = tuple(f for f in fit if f in FAMILIES.get(kind, fit))
    start = int(rng.integers(len(fit)))
    if case.sort == "single":  # three scenes a kind, as far apart in the list as can be
        start = case.slot * max(1, len(fit) // 3) + case.seed // 3
    return fit[start % len(fit)], fit[(start + 1) % len(fit)]


def build(case: Case, master: int, *, strength: float | None = None, camera: Mapping[str, Any] | None = None) -> Built:
    """Draw everything of a case from its name and the half's master seed.

    `strength` takes the place of that of the case's level, `camera` that of what is drawn for the device.
    """
    key = [master, crc32(case.name.encode())]
    rng = np.random.default_rng([*key, 41])
    far = "phase_wrapping" in case.kinds
    device = draw_device(master, int(rng.integers(DEVICES)) % (3 if far else DEVICES), far=far)
    if "temperature_drift" in case.kinds:
        device = replace(device, frame_rate_hz=float(rng.choice([0.5, 1.0, 2.0])))
    device = _fitted(device, case.setting, np.random.default_rng([*key, 42]))
    device = replace(device, **(camera or {}))
    families = _families(case, rng)
    scenes = [draw_scene(family, [*key, k], device.view).surfaces for k, family in enumerate(families)]
    noise = calibrated(replace(device, name="", frame_rate_hz=25.0, frames=1, lens=None))
    models = (scenes[0], scenes[1])
    if case.setting == MISSING_OBJECT:
        scenes[0] = with_object(scenes[0], device.view, [*key, 0])
    mechanisms = tuple(_mechanisms(case, rng, device, scenes[0], strength))
    if case.sort == "nearly":
        models = (nearly(scenes[0], device, rng), nearly(scenes[1], device, rng))
        noise = replace(noise, sigma_mm=noise.sigma_mm * (1 + 0.01 * float(rng.choice([-1, 1]))))
    return Built(
        case=case,
        device=device,
        noise=noise,
        scenes=(scenes[0], scenes[1]),
        models=models,
        families=families,
        mechanisms=mechanisms,
        seeds=tuple(int(s) for s in rng.integers(2**31, size=6)),
    )


def _fitted(device: Device, setting: str, rng: np.random.Generator) -> Device:
    """The camera under room light, or with a lens."""
    if setting == "room_light":
        return in_room_light(device, sigma_mm=float(rng.uniform(28, 36)))
    if setting == "pinhole":
        return replace(device, lens=draw_lens(device, rng))
    return device


def in_room_light(device: Device, *, sigma_mm: float) -> Device:
    """A camera with a stronger lamp in a room so bright that a board of reflectivity 0.5 has this noise at 5 m.

    The lamp is stronger so that the signal's own electrons are few beside the room's, and twice the light is noise of
    a factor root 2 everywhere.
    """
    bright = replace(device, electrons=1.0e8)
    amplitude = float(bright.amplitude(np.array(5000.0), np.array(STANDARD_GLOSS)))
    return replace(bright, room_electrons=2 * (sigma_mm * 2 * np.pi / device.unambiguous_mm * amplitude) ** 2)


def draw_lens(device: Device, rng: np.random.Generator) -> Lens:
    """A lens with the device's fields of view at the image's middle lines, barrel distortion and an axis off centre."""
    half = np.radians(device.fov_horizontal_deg) / 2, np.radians(device.fov_vertical_deg) / 2
    focal = float(0.5 / np.tan(half[0])), float(0.5 / np.tan(half[1]))
    return Lens(
        focal=focal,
        off_center=(float(rng.uniform(-0.03, 0.03)), float(rng.uniform(-0.03, 0.03))),
        radial=(float(rng.uniform(-0.25, -0.12)), float(rng.uniform(0.02, 0.05)), float(rng.uniform(-0.005, 0.005))),
    )


def _mechanisms(
    case: Case, rng: np.random.Generator, device: Device, surfaces: list[Surface], strength: float | None
) -> list[Mechanism]:
    if case.setting == MISSING_OBJECT:
        return []
    if case.sort == "stranger":
        return [make_stranger(case.kinds[0], int(rng.integers(2**31)))]
    place = Place(device=device, surfaces=surfaces, beams=cast(surfaces, device.view))
    out: list[Mechanism] = []
    for kind in case.kinds:
        size = strengths()[kind][case.level] * float(np.exp(rng.uniform(-0.15, 0.15)))
        out.append(make(kind, size if strength is None else strength, rng, place))
    return out


def nearly(surfaces: list[Surface], device: Device, rng: np.random.Generator) -> list[Surface]:
    """A model that is off as models are: each pose by a tenth of sigma, each reflectivity by 5 %."""
    out = []
    for s in surfaces:
        moved = s.shifted(0.1 * pose_sigma(s, device) * float(rng.choice([-1, 1])))
        out.append(replace(moved, reflectivity=s.reflectivity * (1 + 0.05 * float(rng.choice([-1, 1])))))
    return out


def pose_sigma(surface: Surface, device: Device) -> float:
    """The sigma in whose units a surface's pose is uncertain: that at its plane's distance."""
    return float(device.design_sigma(abs(surface.axes()[:, 2] @ np.array(surface.center_mm))))
