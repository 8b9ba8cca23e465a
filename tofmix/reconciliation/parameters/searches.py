"""Searches for the numbers of effects: what each effect declares, with the data of the recordings that it needs.

An effect without a hidden state declares its searches in its own file (`tofmix.simulation.effects.search`). Effects
with a hidden state are in `tofmix.reconciliation.likelihood.hidden_fits`.

The plane of a surface is measured here: changes of its ranges with its pose, and the pose from its measured ranges.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from tofmix.arrays import BoolArray, FloatArray
from tofmix.reconciliation.evidence import LEAST_PIXELS
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.memory import sees_one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture, plane_distance
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.base import refuse_without_phase
from tofmix.simulation.effects.search import (
    OUT_OF_SIGHT,
    Problem,
    SearchFacts,
    SurfaceFacts,
    image_places,
    problems_of,
)
from tofmix.simulation.surface import Surface, tilts_to

_PASSES, _FAR = 12, 6.0  # of a fit; largest residual of a pixel, in medians of the residuals
_HALF_CELL_MM = 0.5  # samples are whole mm


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanePose:
    """A pose relative to that of the model.

    Parameters
    ----------
    shift_mm : float
        Along the model's normal, mm.
    tilts_deg : (float, float)
        About the surface's own u and v axes, degrees.
    explained : float
        Share of the weighted squares of the biases that the pose explains.
    z : float
        Distance from the model's pose, in standard errors.
    turn_nats : float
        Gain of the tilts beyond a shift, nats.
    """

    shift_mm: float
    tilts_deg: tuple[float, float]
    explained: float
    z: float
    turn_nats: float


def ranges_to(surface: Surface, beams: FloatArray) -> FloatArray:
    """Range (n,) at which unit beams (n, 3) meet the plane of a surface, mm; inf where they run along it."""
    normal = surface.rotation()[:, 2]
    with np.errstate(divide="ignore"):
        return np.asarray(float(normal @ np.array(surface.center_mm)) / (beams @ normal))


def range_slopes(surface: Surface, beams: FloatArray) -> FloatArray:
    """Derivatives of ranges along unit beams (n, 3) by shift and both tilts: (n, 3), mm/mm and mm/degree.

    The plane n . p = n . c, c shifted along n and n turned about c, is met at r = n . c / (n . d).
    """
    center = np.array(surface.center_mm)
    u, v, normal = surface.rotation().T
    facing = beams @ normal
    slopes = [1.0 / facing]
    for turned in (-v, u):  # the change of the normal by a tilt about u, and by one about v
        change = float(turned @ center) / facing - float(normal @ center) * (beams @ turned) / facing**2
        slopes.append(np.radians(1.0) * change)
    return np.stack(slopes, axis=1)


def measured_pose(surface: Surface, beams: FloatArray, bias_mm: FloatArray, information: FloatArray) -> PlanePose:
    """The plane through a surface's pixels at their measured mean ranges.

    A beam d meets the plane q . p = 1 at the range 1 / (q . d), so the inverse range is linear in q. Pixels with large
    residuals see another surface, because an edge has moved; they are left out.


    Parameters
    ----------
    surface : Surface
        The surface of the model.
    beams : (n, 3) float64
        Unit vectors of the pixels that see it.
    bias_mm : (n,) float64
        Measured minus predicted mean range.
    information : (n,) float64
        Of the bias, 1/mm2.

    References
    ----------
    Schlossmacher, J. Am. Stat. Assoc. 68 (1973) 857: least absolute values by weighted least squares.
    """
    expected = ranges_to(surface, beams)
    least_mm = 1.0  # range
    measured = np.maximum(expected + bias_mm, least_mm)
    root = np.sqrt(information) * expected**2  # the error of 1 / r is that of r over r squared
    rows, wanted = beams * root[:, None], (1 / measured - 1 / expected) * root
    use = np.isfinite(wanted)
    shift = float(np.median(bias_mm[use])) if use.any() else 0.0
    left: FloatArray = np.where(use, (bias_mm - shift) * np.sqrt(information), np.inf)
    change: FloatArray = np.zeros(3)
    for _ in range(_PASSES):  # least absolute values: up to a third of the pixels may be far off
        weight = np.where(use, 1.0 / np.sqrt(np.maximum(np.abs(left), 1.0)), 0.0)
        change = np.asarray(np.linalg.lstsq(rows[use] * weight[use, None], wanted[use] * weight[use], rcond=None)[0])
        left = np.where(use, wanted - rows @ change, np.inf)
    use = np.abs(left) <= _FAR * max(float(np.median(np.abs(left))), 1.0)
    change = np.asarray(np.linalg.lstsq(rows[use], wanted[use], rcond=None)[0])
    left = wanted - rows @ change
    normal, center = surface.rotation()[:, 2], np.array(surface.center_mm)
    after = normal / float(normal @ center) + change
    new = after / np.linalg.norm(after) * math.copysign(1.0, float(after @ normal))
    weighed, along = information[use] * bias_mm[use], 1.0 / (beams @ normal)[use]
    total, rest = float((weighed * bias_mm[use]).sum()), float((left[use] ** 2).sum())
    shifted = float((weighed * along).sum()) ** 2 / max(float((information[use] * along**2).sum()), 1e-30)
    curvature = rows[use].T @ rows[use]
    return PlanePose(
        shift_mm=(1.0 - float(after @ center)) / float(after @ normal),
        tilts_deg=tilts_to(surface, new),
        explained=1.0 - rest / max(total, 1e-30),
        turn_nats=0.5 * (total - rest - shifted),
        z=math.sqrt(max(float(change @ curvature @ change), 0.0)),
    )


_GLANCE = 25  # frames for medians
_COURSE_FRAMES, _COURSE_PIXELS = 100, 1000  # for the course in time: their medians are known to some 0.05 sigma
_OUTLYING = 4.0  # sigma, beyond which a difference of two frames is no noise
_TO_SIGMA = 1.4826 / math.sqrt(2)  # of the median size of differences of two frames of Gaussian noise
_KNOWN_OF_MEDIAN = 2 / math.pi  # information of a median over that of a mean

_Main = tuple[NDArray[Any], ...]


def problems(kind: str, likelihood: Likelihood, mixture: Mixture) -> list[Problem]:
    """The searches of a kind; none if the camera or the scene cannot have it."""
    effect = EFFECTS[kind]
    if effect.acts_on_phase:
        try:
            refuse_without_phase(kind, likelihood.scene.model.sensor)
        except ValueError:
            return []
    return problems_from(effect, search_facts(likelihood, mixture))


def problems_from(effect: type[Effect], facts: SearchFacts) -> list[Problem]:
    """The searches of a kind that the camera can have, from the data of recordings."""
    return [_plausible(problem) for problem in problems_of(effect, facts)]


def _plausible(problem: Problem) -> Problem:
    """The search; vectors with numbers that no camera has, by their prior, count as another effect."""

    def other(x: FloatArray) -> bool:
        try:
            return (problem.other is not None and problem.other(x)) or not problem.make(x).plausible()
        except ValueError:
            return True

    return replace(problem, other=other)


def search_facts(likelihood: Likelihood, mixture: Mixture) -> SearchFacts:
    """The data that determine the starts, for a mixture."""
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    seen_by = list(views(likelihood, mixture, whole))
    surfaces = {s.name: s for view in seen_by for s in view.scene.model.surfaces}
    pixels = [_main(view) for view in seen_by]
    lit, sigma, mean, name, amplitude, lost, median = (np.concatenate(values) for values in zip(*pixels, strict=True))
    seen, plane_points = [], 3  # which a plane needs
    for surface in likelihood.scene.names:
        own = lit & (name == surface)
        if own.sum() >= plane_points:
            away = (median - mean)[own & ~np.isnan(median)]
            residual = float(np.median(away)) if away.size else 0.0
            typical = float(np.median(sigma[own]))
            facts = SurfaceFacts(
                surface=surfaces[surface],
                sigma_mm=typical,
                residual_mm=residual,
                pixels=int(own.sum()),
                speed_mm_s=_speed(surfaces[surface], seen_by),
            )
            seen.append(_with_pose(facts, seen_by))
    phased = likelihood.scene.model.sensor.modulation_frequency_hz is not None
    turn = likelihood.scene.model.sensor.turn_mm("reconcile") if phased else math.nan
    interval = float(np.median(np.abs(np.diff(likelihood.evidence.time_s))))
    return SearchFacts(
        sigma_mm=float(np.median(sigma[lit])) if lit.any() else float(np.median(sigma)),
        turn_mm=turn,
        duration_s=max(float(likelihood.evidence.time_s.max()), 1e-3),
        recorded_s=max(interval * max(f.stop - f.start for f in likelihood.evidence.recordings), 1e-3),
        interval_s=interval,
        surfaces=tuple(seen),
        farthest_mm=float(np.where(mixture.lit & (mixture.weight > 0), mixture.true_range, 0.0).max()),
        range_mm=mean[lit],
        place=np.tile(image_places(likelihood.evidence.image), (len(seen_by), 1))[lit],
        amplitude=amplitude[lit],
        residual_mm=(median - mean)[lit],
        noise_mm=sigma[lit],
        measured_noise_mm=np.concatenate([_noise(view) for view in seen_by])[lit],
        amplitudes=amplitude,
        lost_shares=lost,
        course=partial(_course, seen_by),
        gain=partial(_gain, likelihood, (lit, median - mean, sigma)),
        nearer=partial(_nearer, seen_by),
    )


def _speed(surface: Surface, seen_by: Sequence[RecordingView]) -> float:
    """As `SurfaceFacts.speed_mm_s`: the mode of the samples' ways over their times, but for the first times.

    Where a surface leaves the sight of most of its pixels, the rest of them still tell its speed.
    """
    most, found = 50_000, []  # samples, enough for a mode
    for view in seen_by:
        m, time_s = view.mixture, view.evidence.time_s
        lit, _, mean, names, *_ = _main(view)
        own, late = np.flatnonzero(lit & (names == surface.name)), np.flatnonzero(time_s > time_s[-1] / 4)
        if not own.size or not late.size:
            continue
        own = own[:: max(1, own.size * late.size // most)]
        few = view.evidence.samples[np.ix_(late, own)].astype(np.float64)
        along = plane_distance(surface) / mean[own]
        speed = m.near_turn(few - mean[own]) * along / time_s[late, None]
        found.append(speed[few > 0])
    return _mode(np.concatenate([np.zeros(0), *found]))


def _mode(values: FloatArray) -> float:
    """The half-sample mode of values; 0 of none.

    References
    ----------
    Bickel and Fruehwirth, Computational Statistics and Data Analysis 50 (2006) 3500.
    """
    few = 3  # values of which the mean is taken
    values = np.sort(values)
    while values.size > few:
        half = (values.size + 1) // 2
        first = int(np.argmin(values[half - 1 :] - values[: values.size - half + 1]))
        values = values[first : first + half]
    return float(values.mean()) if values.size else 0.0


def _with_pose(seen: SurfaceFacts, seen_by: Sequence[RecordingView]) -> SurfaceFacts:
    """A surface with its pose, from pixels of the first recording that shows it, and tilts of one sigma."""
    at_the_edge = 0.95  # quantile
    least_lever = 0.1  # mm a degree: a tilt with less effect on ranges is not searched for
    for view in seen_by:
        lit, _, mean, names, _, _, median = _main(view)
        own = lit & (names == seen.name) & ~np.isnan(median)
        if own.sum() < LEAST_PIXELS:
            continue
        beams = view.scene.beams[own]
        known = np.full(int(own.sum()), _KNOWN_OF_MEDIAN * min(len(view.evidence.samples), _GLANCE) / seen.sigma_mm**2)
        pose = measured_pose(seen.surface, beams, (median - mean)[own], known)
        slopes = np.quantile(np.abs(range_slopes(seen.surface, beams)[:, 1:]), at_the_edge, axis=0)
        about_u, about_v = (seen.sigma_mm / float(v) if v > least_lever else 0.0 for v in slopes)
        return replace(
            seen,
            shift_mm=pose.shift_mm,
            tilts_deg=pose.tilts_deg,
            turn_nats=pose.turn_nats,
            turned_deg=(about_u, about_v),
        )
    return seen


def _gain(likelihood: Likelihood, pixels: tuple[BoolArray, FloatArray, FloatArray], effect: Effect) -> float:
    """As `SearchFacts.gain`: the bias is that beside the model as given."""
    lit, residual, sigma = pixels
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    pairs = (views(likelihood, likelihood.scene.mixture(effects), whole) for effects in ((), (effect,)))
    moved = [
        after.mixture.of_main(after.mixture.mean) - before.mixture.of_main(before.mixture.mean)
        for before, after in zip(*pairs, strict=True)
    ]
    bias = np.concatenate(moved)
    use = lit & np.isfinite(residual)
    weighed = bias[use] * _KNOWN_OF_MEDIAN * min(likelihood.evidence.shape[0], _GLANCE) / sigma[use] ** 2
    size, pull = float(weighed @ bias[use]), float(weighed @ residual[use])
    return 0.5 * pull**2 / size if pull > 0 and size > 0 else 0.0


def _course(seen_by: Sequence[RecordingView]) -> tuple[FloatArray, FloatArray]:
    """As `SearchFacts.course`."""
    parts = [_course_of(view) for view in seen_by]
    times, medians = (np.concatenate(values) for values in zip(*parts, strict=True))
    return times[np.isfinite(medians)], medians[np.isfinite(medians)]


def _course_of(view: RecordingView) -> tuple[FloatArray, FloatArray]:
    """The course of one recording; NaN in frames without a valid sample."""
    m, samples = view.mixture, view.evidence.samples
    frames = np.linspace(0, len(samples) - 1, min(len(samples), _COURSE_FRAMES)).astype(np.int64)
    lit = np.flatnonzero(m.of_main(m.lit))
    lit = lit[:: max(1, lit.size // _COURSE_PIXELS)]
    few = samples[np.ix_(frames, lit)].astype(np.float64)
    away = np.where(few > 0, m.near_turn(few - m.of_main(m.mean)[lit]), np.nan)
    median = np.full(frames.size, np.nan)
    some = np.isfinite(away).any(axis=1)
    median[some] = np.nanmedian(away[some], axis=1)
    return np.asarray(view.evidence.time_s[frames]), median


def _nearer(seen_by: Sequence[RecordingView], low_mm: float, high_mm: float) -> tuple[float, float, float] | None:
    """As `SearchFacts.nearer`."""
    counts, values = zip(*(_before_the_scene(view, low_mm, high_mm) for view in seen_by), strict=True)
    near = np.concatenate(values)
    if not near.size:
        return None
    low, high = np.quantile(near, (0.16, 0.84))  # a sigma about the mean: a median deviation is 0 on a coarse grid
    middle = float(trim_mean(near, 0.05))
    return near.size / sum(counts), middle, max(0.5 * float(high - low), _HALF_CELL_MM)


def _before_the_scene(view: RecordingView, low_mm: float, high_mm: float) -> tuple[int, FloatArray]:
    """How many of some samples are valid, and those nearer than all that the model has in their pixel, mm."""
    m = view.mixture
    samples = view.evidence.samples[:: max(1, len(view.evidence.samples) // _GLANCE)]
    nearest = np.where(m.weight > 0, m.mean - OUT_OF_SIGHT * m.sigma, np.inf).min(axis=(0, 1))
    near = (samples > low_mm) & (samples < np.minimum(nearest, high_mm))
    return int((samples > 0).sum()), samples[near].astype(np.float64)


def _noise(view: RecordingView) -> FloatArray:
    """As `SearchFacts.measured_noise_mm`, of all pixels: the root mean square difference of consecutive frames."""
    # the noise from frame to frame is then known to some 5 %
    m, samples = view.mixture, view.evidence.samples[:200].astype(np.float64)
    out = np.full(samples.shape[1], np.nan)
    if len(samples) < 3:  # noqa: PLR2004  of one difference there is no median
        return out
    samples[samples == 0] = np.nan
    away = m.near_turn(np.diff(samples, axis=0)) if m.period > 0 else np.diff(samples, axis=0)
    use = sees_one_surface(m) & (np.isfinite(away).sum(axis=0) >= 0.5 * len(away))  # half of the differences
    away = np.abs(away[:, use])
    typical = _TO_SIGMA * np.nanmedian(away, axis=0)
    limit = _OUTLYING * math.sqrt(2) * np.maximum(typical, _HALF_CELL_MM)
    out[use] = np.sqrt(0.5 * np.nanmean(np.where(away <= limit, away**2, np.nan), axis=0))
    return out


def _main(view: RecordingView) -> _Main:
    """For each pixel (pixel,), of its main component: lit, sigma, mean, surface's name, amplitude.

    Also its share of lost samples, and the median of some valid samples, NaN if there is none.
    """
    m = view.mixture
    names = np.array([*view.scene.names, ""], dtype=object)[m.of_main(m.surface)]
    samples = view.evidence.samples
    lost = (samples == 0).mean(axis=0)
    few = samples[:: max(1, len(samples) // _GLANCE)].astype(np.float64)
    few[few == 0] = np.nan
    if m.period > 0:
        few = m.of_main(m.mean) + m.near_turn(few - m.of_main(m.mean))
    some = ~np.isnan(few).all(axis=0)
    median = np.full(lost.shape, np.nan)
    median[some] = np.nanmedian(few[:, some], axis=0)
    lit, sigma, mean = m.of_main(m.lit).astype(bool), m.of_main(m.sigma), m.of_main(m.mean)
    return lit, sigma, mean, names, m.of_main(m.amplitude), lost, median
