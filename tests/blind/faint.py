"""How weak an effect a detector finds that knows its kind: the measure of `faint`.

    PYTHONPATH=tests python -m blind.faint [KIND ...]    prints, for each kind, lines of strengths.toml

The detector knows kind and shape (phase, knee, surface, step) and asks only whether the effect is there. It must
forgive what the contract forgives, so its null are nearly right models: sigma off by 1 %, poses by a tenth of sigma,
reflectivities by 5 %. Its statistic is the projection of the samples' normal scores under the model on the effect's own
template (biases), or a count, a lag, a spread, a line in the spectrum (others). `found` is the strength at which it
exceeds the null's 99 % quantile in 95 % of the recordings, for the smallest image and the fewest frames of the bench; a
second set of recordings says in which share it really does.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from blind.calibrate import calibrated
from blind.camera import Device, Mechanism, _correlation, expose, record
from blind.cases import draw_device, nearly, pose_sigma, strengths
from blind.effects import CoarsePhase, Effect, MisplacedBoard, MovingBoard, Place, SunOnBoard
from blind.eligible import FAMILIES
from blind.geometry import Array, Beams, Surface, cast
from blind.reference import NoiseTable, scores
from blind.scenes import draw_scene
from blind.strength import make

NULLS, RESPONSES, CHECKS = 12, 6, 12
TEMPLATES = (
    "range_offset",
    "surface_pose",
    "surface_offset",
    "smooth_pattern",
    "wiggling",
    "tap_mismatch",
    "amplitude_walk",
    "temperature_drift",
    "scattering",
    "multipath",
    "motion",
    "pixel_crosstalk",
    "internal_reflection",
)
SQUARES = ("fixed_pattern", "interference", "quantisation")  # the statistic grows with the strength's square


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One scene, its nearly right model, and what the detector needs of it."""

    device: Device
    scene: list[Surface]
    model: list[Surface]
    noise: NoiseTable
    beams: Beams  # of the model

    def scores(self, range_mm: Array, rng: np.random.Generator) -> Array:
        """Normal scores under the nearly right model."""
        return scores(range_mm.reshape(len(range_mm), -1).astype(float), self.beams, self.device, self.noise, rng)

    def main(self) -> Array:
        return np.asarray(self.beams.share[0] > 0.999)


def draw_trial(kind: str, seed: int) -> Trial:
    """A trial of the smallest image and the fewest frames."""
    rng = np.random.default_rng([seed, 81])
    device = replace(draw_device(81, 0), frames=200)
    if kind == "temperature_drift":
        device = replace(device, frame_rate_hz=1.0)
    families = FAMILIES[kind]
    scene = draw_scene(families[seed % len(families)], [seed, 82], device.view).surfaces
    noise = calibrated(replace(device, name="", frame_rate_hz=25.0, frames=1))
    model = nearly(scene, device, rng)
    off = NoiseTable(range_mm=noise.range_mm, sigma_mm=noise.sigma_mm * (1 + 0.01 * float(rng.choice([-1, 1]))))
    return Trial(device=device, scene=scene, model=model, noise=off, beams=cast(model, device.view))


def template(trial: Trial, mechanism: Mechanism) -> Array:
    """Bias (frame, pixel) of a mechanism in units of sigma, without noise, on pixels of one surface."""
    few = trial.device if mechanism.kind in ("temperature_drift", "motion") else replace(trial.device, frames=1)
    plain = expose(few, trial.scene, (), 0)
    x = expose(few, trial.scene, (mechanism,), 0)
    mechanism.light(x)
    mechanism.clock(x)
    taps = [_correlation(x, slice(None), k) for k in range(4)]
    phasor = 0.5 * ((taps[0] - taps[2]) + 1j * (taps[1] - taps[3]))
    turn = x.device.phasor(-plain.true_mm)
    bias = x.device.unambiguous_mm / (2 * np.pi) * np.angle(phasor * turn)
    single = trial.main() & (plain.beams.share[0] > 0.999)
    if isinstance(mechanism, MisplacedBoard | MovingBoard):
        single = single & (x.key_beams[0].share[0] > 0.999) & (x.key_beams[-1].share[0] > 0.999)
    return np.asarray(np.where(single, bias / trial.noise.sigma(np.maximum(plain.true_mm, 1.0)), 0.0))


def projection(trial: Trial, score: Array, shape: Array) -> float:
    """The scores' component along a template, poses of the surfaces being uncertain by a tenth of sigma."""
    if len(shape) > 1:
        shape = shape - shape.mean(axis=0)
        return float((np.nan_to_num(score) * shape).sum() / np.sqrt((shape**2).sum()))
    frames, use = len(score), shape[0] != 0
    mean, want = np.nanmean(score, axis=0)[use], shape[0][use]
    beams = trial.beams
    size = 0.1 / beams.cosine[0][use] / trial.device.design_sigma(beams.range_mm[0][use])
    loose = np.stack(
        [pose_sigma(s, trial.device) * size * (beams.surface[0][use] == k) for k, s in enumerate(trial.model)], axis=1
    )
    inner = np.linalg.inv(np.eye(loose.shape[1]) / frames + loose.T @ loose)

    def whiten(v: Array) -> Array:
        return np.asarray(frames * (v - loose @ (inner @ (loose.T @ v))))

    return float(want @ whiten(mean) / np.sqrt(want @ whiten(want)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """A recording (frame, pixel) as a detector sees it."""

    trial: Trial
    score: Array
    range_mm: Array
    effect: Effect


def _noise(m: _Seen) -> Array:
    """Scores of the pixels of one surface, each about its own mean, so that a pose does not pass for noise."""
    score = m.score[:, m.trial.main()]
    return np.asarray(np.clip(score - score.mean(axis=0), -3.5, 3.5))


def _count_lost(m: _Seen) -> float:
    return float(np.isnan(m.range_mm).sum())


def _stuck(m: _Seen) -> float:
    return float((np.ptp(m.range_mm, axis=0) < 0.5).sum())


def _wild(m: _Seen) -> float:
    return float((np.abs(m.score[:, m.trial.main()]) > 3.8).sum())


def _lag(m: _Seen) -> float:
    s = m.score - np.nanmean(m.score, axis=0)
    return float((s[1:] * s[:-1]).mean() * np.sqrt(s.size))


def _spread(m: _Seen) -> float:
    level = (_noise(m) ** 2).mean(axis=0)
    if not isinstance(m.effect, SunOnBoard):
        return float(level.mean())
    number = [s.name for s in m.trial.model].index(m.effect.surface)
    own = m.trial.beams.surface[0][m.trial.main()] == number
    return float(1 + (level[own].mean() - 1) * np.sqrt(own.mean()))


def _fall(m: _Seen) -> float:
    azimuth, elevation = m.trial.device.view.angles()
    want = -np.log(np.cos(azimuth) * np.cos(elevation))
    want = np.where(m.trial.main(), want - want[m.trial.main()].mean(), 0.0)
    s = _noise(m)
    return float((s**2).mean(axis=0) @ want[m.trial.main()] / np.linalg.norm(want) * np.sqrt(len(s)))


def _squares(m: _Seen) -> float:
    mean = m.score[:, m.trial.main()].mean(axis=0)
    surface = m.trial.beams.surface[0][m.trial.main()]
    for k in np.unique(surface):
        mean[surface == k] -= mean[surface == k].mean()
    return float((mean**2).mean() * len(m.score))


def _bursts(m: _Seen) -> float:
    level = (_noise(m) ** 2).mean(axis=1)
    level -= np.median(level)
    return float(((np.convolve(level, np.ones(5) / 5, "valid")) ** 2).mean() * m.score.size)


def _between(m: _Seen) -> float:
    share, mean = m.trial.beams.share, m.trial.beams.range_mm
    mixed = np.flatnonzero(((share > 0).sum(axis=0) > 1) & (m.trial.beams.nothing == 0))
    near = np.full((len(m.range_mm), mixed.size), np.inf)
    for k in range(len(share)):
        there = share[k][mixed] > 0
        off = np.abs(m.range_mm[:, mixed] - mean[k][mixed]) / m.trial.noise.sigma(mean[k][mixed])
        near = np.where(there, np.minimum(near, off), near)
    return float((near > 4.5).sum())


def _line(m: _Seen) -> float:
    assert isinstance(m.effect, CoarsePhase)
    turn = np.exp(2j * np.pi / m.effect.step(m.trial.device) * m.range_mm[:, m.trial.main()])
    return float(np.abs(turn.sum()) ** 2 / turn.size)


_COUNTS: dict[str, Callable[[_Seen], float]] = {
    "dropout": _count_lost,
    "saturation": _count_lost,
    "stuck_pixels": _stuck,
    "near_return": _wild,
    "outliers": _wild,
    "temporal_correlation": _lag,
    "excess_noise": _spread,
    "vignetting": _fall,
    "fixed_pattern": _squares,
    "interference": _bursts,
    "flying_pixels": _between,
    "quantisation": _line,
}


def statistic(kind: str, seed: int, strength: float, *, present: bool) -> float:
    """The detector's statistic on one recording."""
    trial = draw_trial(kind, seed)
    place = Place(device=trial.device, surfaces=trial.scene, beams=cast(trial.scene, trial.device.view))
    effect = make(kind, strength, np.random.default_rng([seed, 83]), place)
    recording = record(trial.device, trial.scene, (effect,) if present else (), seed=1000 * (1 + present) + seed)
    score = trial.scores(recording.range_mm, np.random.default_rng([seed, 84]))
    if kind in TEMPLATES:
        return projection(trial, score, template(trial, effect))
    flat = recording.range_mm.reshape(len(recording.range_mm), -1)
    return _COUNTS[kind](_Seen(trial=trial, score=score, range_mm=flat, effect=effect))


def measure(kind: str) -> tuple[float, float]:
    """`found`, and the share of fresh recordings in which the detector finds it."""
    strength = strengths()[kind]["faint"]
    power = 2 if kind in SQUARES else 1
    nulls = np.array([statistic(kind, s, strength, present=False) for s in range(NULLS)])
    limit = nulls.mean() + 2.33 * nulls.std(ddof=1)
    if kind in ("dropout", "saturation", "stuck_pixels"):
        limit = 0.5  # none is ever lost or stuck without the effect
    for _ in range(2):  # the statistic may bend: again from where the guess led
        seen = np.array([statistic(kind, s, strength, present=True) for s in range(RESPONSES)])
        before, strength = strength, _enough(nulls, limit, seen, strength, power)
        if 0.7 < strength / before < 1.4:
            break
    hits = np.mean([statistic(kind, 200 + s, strength, present=True) > limit for s in range(CHECKS)])
    return strength, float(hits)


def _enough(nulls: Array, limit: float, seen: Array, strength: float, power: int) -> float:
    """The strength beyond the limit in 95 % of the recordings of nine in ten scenes; the response goes as its power."""
    if limit == 0.5:  # lost samples are counts: Poisson with mean 3 is not 0 in 95 %
        return float(strength * 3.0 / max(float(np.quantile(seen, 0.25)), 0.5))
    response = np.maximum(seen - nulls[: seen.size], 1e-9) / strength**power  # scene by scene
    wanted = limit - nulls.mean() + 1.645 * nulls.std(ddof=1)
    needed = np.minimum((wanted / response) ** (1 / power), 6 * strength)
    return float(np.quantile(needed, 0.9))


def main() -> None:
    for kind in sys.argv[1:] or [k for k in strengths() if k != "phase_wrapping"]:
        found, hits = measure(kind)
        print(f"[{kind}]\nfound = {found:.3g}  # seen in {hits:.2f} of {CHECKS}\n", flush=True)


if __name__ == "__main__":
    main()
