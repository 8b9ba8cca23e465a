"""A faint bias cannot be taken for another bias on the scenes on which it is hidden."""

import math
from dataclasses import replace

import numpy as np
import pytest

from blind.cases import draw_device, in_room_light, strengths
from blind.effects import Place
from blind.eligible import FAMILIES, ROOM_LIGHT
from blind.faint import Trial, template
from blind.geometry import Array, cast
from blind.reference import NoiseTable
from blind.scenes import draw_scene
from blind.strength import make

BIASES = (
    "range_offset",
    "surface_pose",
    "wiggling",
    "tap_mismatch",
    "amplitude_walk",
    "scattering",
    "internal_reflection",
    "multipath",
)
SAMPLES = 48 * 64 * 200  # of the smallest recording of the bench


def _trial(family: str, seed: int, *, room_light: bool = False) -> Trial:
    device = replace(draw_device(81, 0), rows=24, cols=32)
    if room_light:
        device = in_room_light(device, sigma_mm=32.0)
    scene = draw_scene(family, [seed, 91], device.view).surfaces
    ranges = np.linspace(200.0, device.range_max_mm, 200)
    noise = NoiseTable(range_mm=ranges, sigma_mm=device.design_sigma(ranges))
    return Trial(device=device, scene=scene, model=scene, noise=noise, beams=cast(scene, device.view))


def _sigma(trial: Trial) -> Array:
    """Sigma (pixel,) of the nearest surface of each beam, mm."""
    beams = trial.beams
    gloss = np.array([s.reflectivity for s in trial.scene])[beams.surface[0]] * beams.cosine[0]
    return np.asarray(trial.device.sigma(np.maximum(beams.range_mm[0], 1.0), gloss))


def _template(trial: Trial, kind: str, size: float, seed: int, place: Place) -> Array:
    """Bias (pixel,) in units of the surfaces' own sigma."""
    by_range = trial.noise.sigma(np.maximum(trial.beams.range_mm[0], 1.0))
    return np.asarray(
        template(trial, make(kind, size, np.random.default_rng(seed), place))[0] * by_range / _sigma(trial)
    )


def _rivals(trial: Trial, place: Place, kind: str) -> dict[str, Array]:
    """Templates (pixel, parameter) of the other biases, each with what it may fit freely."""
    beams, device = trial.beams, trial.device
    sigma = _sigma(trial)
    wave = 8 * math.pi * beams.range_mm[0] / device.unambiguous_mm
    out = {
        "range_offset": 1 / sigma[:, None],
        "wiggling": np.stack([np.sin(wave), np.cos(wave)], axis=1) / sigma[:, None],
    }
    for k, surface in enumerate(trial.scene):
        on = beams.surface[0] == k
        cosine = np.maximum(beams.cosine[0], 1e-3)
        out[f"surface_pose of {surface.name}"] = (on / cosine / sigma)[:, None]
        out[f"multipath on {surface.name}"] = (on / sigma)[:, None]
    for name in ("amplitude_walk", "scattering", "internal_reflection"):
        out[name] = _template(trial, name, 0.2, 7, place)[:, None]
    return {name: columns for name, columns in out.items() if not name.startswith(kind)}


_KINDS = ["wiggling", *(pytest.param(k, marks=pytest.mark.slow) for k in BIASES if k != "wiggling")]


@pytest.mark.parametrize(
    "room_light", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["ordinary", "room light"]
)
@pytest.mark.parametrize("kind", _KINDS)
def test_no_rival_explains_a_faint_bias(kind: str, *, room_light: bool) -> None:
    """What the best rival leaves stands out by 6 standard errors and more, on every family."""
    for family in (ROOM_LIGHT if room_light else FAMILIES)[kind]:
        trial = _trial(family, 3, room_light=room_light)
        place = Place(device=trial.device, surfaces=trial.scene, beams=trial.beams)
        wanted = _template(trial, kind, strengths()[kind]["faint"], 5, place)
        use = wanted != 0 if kind not in ("surface_pose", "multipath") else trial.main()
        scale = math.sqrt(SAMPLES / trial.device.view.pixels)
        for rival, columns in _rivals(trial, place, kind).items():
            fit, *_ = np.linalg.lstsq(columns[use], wanted[use], rcond=None)
            left = np.linalg.norm(wanted[use] - columns[use] @ fit) * scale
            assert left > 6, f"{rival} explains {kind} on {family}: {left:.1f} left"
