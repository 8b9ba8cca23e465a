"""What tests and benchmarks of the standard errors share: a small scene, an effect, and how far fits miss the truth."""

import math
from dataclasses import replace

import numpy as np

from support.recordings import MAKE, simulated
from support.simplex import fit
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.hidden_states import latent_states
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.parameters.fits import Fitted, Numbers
from tofmix.reconciliation.parameters.polish import settle
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.parameters.standard_errors import numeric, standard_errors
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.sensor import NoiseCurve
from tofmix.sensors import load_profile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface

FRAMES = 120
MEMORY = MAKE["temporal_correlation"](coefficient=0.5)
LATENT = ("interference", "temporal_correlation", "quantisation")
"""Kinds that only the whole search fits."""
EFFECTS_OF: dict[str, tuple[Effect, ...]] = {
    "range_offset": (MAKE["range_offset"](offset_mm=8.0),),
    "surface_pose": (MAKE["surface_pose"](surface="middle", shift_mm=15.0),),
    "surface_offset": (MAKE["surface_offset"](surface="middle", offset_mm=15.0),),
    "smooth_pattern": (MAKE["smooth_pattern"](radial_2_mm=12.0),),
    "wiggling": (MAKE["wiggling"](amplitude_mm=10.0, phase_rad=0.7),),
    "wiggling, a harmonic": (MAKE["wiggling"](amplitude_mm=10.0, phase_rad=0.7, harmonics=((8.0, 6.0, 1.9),)),),
    "tap_mismatch": (MAKE["tap_mismatch"](amplitude_2_mm=10.0, phase_2_rad=0.7),),
    "amplitude_walk": (MAKE["amplitude_walk"](scale_mm=8.0, reference_amplitude=100.0, exponent=0.8),),
    "temperature_drift": (MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=4.0),),
    "motion": (MAKE["motion"](surface="middle", velocity_mm_s=2.0),),
    "scattering": (MAKE["scattering"](share=0.02),),
    "multipath": (MAKE["multipath"](surface="middle", share=0.08, extra_path_mm=1500.0),),
    "internal_reflection": (MAKE["internal_reflection"](amplitude=3.0, range_mm=20.0),),
    "near_return": (MAKE["near_return"](share=0.08, range_mm=25.0, sigma_mm=5.0),),
    "temperature_drift, slow": (MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=20.0),),
    "amplitude_walk, saturating": (
        MAKE["amplitude_walk"](scale_mm=30.0, reference_amplitude=100.0, exponent=1.0, saturation_amplitude=40.0),
    ),
    "temperature_drift, two terms": (
        MAKE["temperature_drift"](amplitude_mm=20.0, time_constant_s=4.0, amplitude_2_mm=-12.0, time_constant_2_s=0.5),
    ),
    "multipath, faint": (MAKE["multipath"](surface="middle", share=0.03, extra_path_mm=1500.0),),
    "excess_noise": (MAKE["excess_noise"](factor=1.3),),
    "excess_noise of one surface": (MAKE["excess_noise"](factor=1.3, surface="middle"),),
    "vignetting": (MAKE["vignetting"](corner_factor=1.4),),
    "outliers": (MAKE["outliers"](probability=0.01),),
    "pixel_crosstalk": (MAKE["pixel_crosstalk"](share=0.03),),
    "flying_pixels": (MAKE["flying_pixels"](probability=0.3),),
    "dropout by chance": (MAKE["dropout"](probability=0.03),),
    "dropout of dark samples": (MAKE["dropout"](probability=0.01, threshold=15.0, threshold_noise=3.0),),
    "saturation": (MAKE["saturation"](full_well_amplitude=40.0),),
    "interference": (MAKE["interference"](probability=0.25, sigma_mm=30.0, burst_frames=5.0),),
    "temporal_correlation": (MEMORY,),
    "quantisation": (MAKE["quantisation"](step_mm=9.3),),
    "fixed_pattern": (MAKE["fixed_pattern"](pixel_sigma_mm=6.0, column_sigma_mm=2.0, row_sigma_mm=2.0),),
    "range_offset and wiggling": (
        MAKE["range_offset"](offset_mm=8.0),
        MAKE["wiggling"](amplitude_mm=10.0, phase_rad=0.7),
    ),
    "range_offset and fixed_pattern": (
        MAKE["range_offset"](offset_mm=8.0),
        MAKE["fixed_pattern"](pixel_sigma_mm=6.0, column_sigma_mm=2.0, row_sigma_mm=2.0),
    ),
    "range_offset and pixels alone": (
        MAKE["range_offset"](offset_mm=8.0),
        MAKE["fixed_pattern"](pixel_sigma_mm=6.0, column_sigma_mm=0.0, row_sigma_mm=0.0),
    ),
    "wiggling and columns": (
        MAKE["wiggling"](amplitude_mm=20.0, phase_rad=0.7),
        MAKE["fixed_pattern"](pixel_sigma_mm=2.0, column_sigma_mm=4.0, row_sigma_mm=1.0),
    ),
}
"""Effects that are hidden together."""


def scene(*, rows: int = 16, cols: int = 20, frames: int = FRAMES) -> Model:
    """Two boards and a slanted wall before a small camera."""
    ranges = np.linspace(500.0, 6000.0, 12)
    sensor = replace(
        load_profile("sr3000"),
        rows=rows,
        cols=cols,
        fov_horizontal_deg=50.0,
        fov_vertical_deg=40.0,
        range_min_mm=300.0,
        range_max_mm=7000.0,
        noise=NoiseCurve(ranges, 3.0 + (ranges / 1000) ** 2),
        reference_integration_time_ms=1.0,
        integration_time_ms=1.0,
        modulation_frequency_hz=20e6,
    )
    surfaces = (
        Surface(name="near", center_mm=(-500.0, 0.0, 1300.0), size_mm=(700.0, 700.0), reflectivity=0.9),
        Surface(name="middle", center_mm=(600.0, 100.0, 2300.0), size_mm=(900.0, 900.0), reflectivity=0.3),
        Surface(name="wall", center_mm=(0.0, 0.0, 4000.0), size_mm=(20000.0, 20000.0), yaw_deg=30.0, reflectivity=0.6),
    )
    return Model(sensor=sensor, surfaces=surfaces, recording=RecordingSettings(frames=frames, frame_rate_hz=10.0))


def deviations(model: Model, effects: tuple[Effect, ...], beside: tuple[Effect, ...], *, seed: int) -> dict[str, float]:
    """How far each number of the fitted effects is from the truth, in its standard errors.

    `model`: what the fit knows.
    `effects`: hidden, and fitted.
    `beside`: hidden, and known.
    `seed`: of the recording.
    Returns dict of str to float: by the number's name; empty where a kind that only the whole search fits is not named.
    """
    evidence = simulated(model, (*effects, *beside), seed, model.recording.frames)
    latent = any(e.kind in LATENT for e in effects)
    known = _named(model, evidence, effects) if latent else _fitted(model, evidence, effects, beside)
    out: dict[str, float] = {}
    for wanted, (effect, errors) in zip(effects, known, strict=False):
        out |= in_errors(wanted, effect, errors)
    return out


def in_errors(hidden: Effect, effect: Effect, errors: dict[str, float]) -> dict[str, float]:
    """How far each number of a fitted effect is from that of the hidden one, in its standard errors."""
    found, wanted = numeric(effect), numeric(hidden)
    if effect.kind == "amplitude_walk":  # at the fit's own reference
        wanted["scale_mm"] *= (wanted["reference_amplitude"] / found["reference_amplitude"]) ** wanted["exponent"]
        wanted["reference_amplitude"] = found["reference_amplitude"]
    out = {}
    for name, error in errors.items():
        change = found[name] - wanted[name]
        if error > 0:
            out[name] = (math.remainder(change, 2 * math.pi) if name == "phase_rad" else change) / error
    return out


_Known = tuple[Effect, dict[str, float]]


def _named(model: Model, evidence: Evidence, effects: tuple[Effect, ...]) -> list[_Known]:
    """What the whole search finds, for kinds with latent states of their own."""
    result = reconcile(model, evidence, Settings(kinds=tuple(e.kind for e in effects)))
    return [(n.effect, n.stderr) for n in result.named]


def _fitted(model: Model, evidence: Evidence, effects: tuple[Effect, ...], beside: tuple[Effect, ...]) -> list[_Known]:
    numbers = _fit(Likelihood(evidence, Scene(model, evidence.time_s)), effects, beside)
    errors = standard_errors(numbers)
    return [(effect, errors[k]) for k, effect in enumerate(numbers.state.effects) if k >= len(beside)]


def _fit(likelihood: Likelihood, effects: tuple[Effect, ...], beside: tuple[Effect, ...]) -> Numbers:
    """Fit effects that are known by kind and surface, one given the others; then all at once."""
    pixels = likelihood.evidence.shape[1]
    part = np.flatnonzero(likelihood.evidence.fit_frames), np.arange(pixels)
    state, fits = replace(likelihood.start(), effects=beside), dict[int, Fitted]()
    for number, effect in enumerate(effects, len(beside)):
        if effect.kind == "fixed_pattern":
            state = latent_states(likelihood, replace(state, effects=(*state.effects, effect)), part[0])
            continue
        fitted = _one(likelihood, effect, state, part)
        state = replace(state, effects=(*state.effects, fitted.effect))
        fits[number] = fitted
    return settle(Numbers(likelihood=likelihood, state=state, fits=fits, part=part))


def _one(likelihood: Likelihood, effect: Effect, state: ModelState, part: Part) -> Fitted:
    mixture = likelihood.scene.mixture(state.effects)
    found = [fit(p, likelihood, state, part) for p in problems(effect.kind, likelihood, mixture)]

    def value(fitted: Fitted) -> float:
        return likelihood.objective(replace(state, effects=(*state.effects, fitted.effect)), part)

    return max(
        (f for f in found if _form(f.effect) == _form(effect)),
        key=lambda f: likelihood.objective(replace(state, effects=(*state.effects, f.effect)), part),
    )


def _form(effect: Effect) -> tuple[object, ...]:
    """An effect's surface, and which of its numbers are not 0."""
    return getattr(effect, "surface", ""), *(name for name, value in numeric(effect).items() if value)
