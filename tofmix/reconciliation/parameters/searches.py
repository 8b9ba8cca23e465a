"""Starts and parametrisation of the search for each effect.

Any kind without a hidden state is searched for by its declaration: typical sizes and bounds of its numbers. `SEARCHES`
has the kinds with better starts from the camera or the recording, or with a better parametrisation; kinds with a hidden
state are in `tofmix.reconciliation.search.links`. Numbers have units in which a step of 1 is reasonable: multiples of
sigma, logarithms.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.parameters.planes import PlanePose, measured_pose, range_slopes
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.base import refuse_without_phase
from tofmix.simulation.effects.parameter import Holds
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.surface import Surface

MAKE: Mapping[str, Callable[..., Effect]] = EFFECTS
"""Makes an effect of a kind from its parameters."""

_LEAST_PIXELS = 12  # least pixels of a surface, for effects of this surface
_MOSTLY = 0.5  # share of lost samples, above which a pixel is saturated
_MOST_OUTLIERS = 0.5  # largest share of outliers
_FLAT = 0.1  # exponent of a walk, below which it is an offset
_AT_ONCE = 1.2  # of the shortest time constant, below which a drift is an offset
_OUT_OF_SIGHT = 3.0  # sigma
_GLANCE = 25  # frames for medians
_PAUSED = 1.5  # times the duration of its frames, above which a recording has pauses
_TURNED_NATS = 6.0  # least evidence for tilts, two more numbers
_KNOWN_OF_MEDIAN = 2 / math.pi  # information of a median over that of a mean
_AT_THE_EDGE = 0.95  # quantile
_LEAST_LEVER = 0.1  # mm a degree: a tilt with less effect on ranges is not searched for
_BY_CHANCE = 0.05  # chance that a value lies so near a whole number
_HALF_CELL_MM = 0.5  # samples are whole mm
_LEAST_FRAMES = 3.0  # least time constant of a drift: a faster one is an offset with a bad first frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """One search.

    Parameters
    ----------
    make : callable
        An effect from a vector of numbers; raises ValueError outside its bounds.
    starts : tuple of tuples
        Start vectors.
    steps : tuple of float
        First steps.
    other : callable, optional
        Whether a vector is so close to a bound, or so large, that another effect describes the same.
    parameters : int
        Free parameters.
    """

    make: Callable[[FloatArray], Effect]
    starts: tuple[tuple[float, ...], ...]
    steps: tuple[float, ...]
    other: Callable[[FloatArray], bool] | None = None

    @property
    def parameters(self) -> int:
        """Free parameters."""
        return len(self.steps)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredSurface:
    """A surface, measured by the medians of its pixels."""

    surface: Surface
    sigma: float  # mm
    residual: float  # measured minus predicted range, mm
    pose: PlanePose | None = None  # measured pose
    turned_deg: tuple[float, float] = (0.0, 0.0)  # tilts by which its edges move by sigma

    @property
    def name(self) -> str:
        """Of the surface."""
        return self.surface.name

    @property
    def far(self) -> bool:
        """Whether it is so far off that the likelihood has no slope towards it."""
        return abs(self.residual) > _OUT_OF_SIGHT * self.sigma


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """Data that determine the starts."""

    mixture: Mixture
    sigma: float  # typical, mm
    turn: float  # d_u, mm
    duration: float  # s
    recorded: float  # s, without pauses
    interval: float  # s, between frames
    surfaces: tuple["MeasuredSurface", ...]  # surfaces that fill pixels
    amplitudes: FloatArray
    shares: FloatArray  # of invalid samples by pixel
    residuals: FloatArray  # measured minus predicted range of pixels with a return, mm
    stray: complex  # phasor that, added to every pixel's, explains most of the residuals
    glass: tuple[float, float, float] | None  # share, median, mm, and spread, mm, of samples before the scene


_Main = tuple[NDArray[Any], ...]
_Maker = Callable[[Setting], Iterator[Problem]]


def _bounded(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError(f"{value} is out of bounds")
    return float(value)


def _simple(kind: str, name: str, sizes: tuple[float, ...], *, log: bool, most: float = 1e5) -> _Maker:
    """One number, as a logarithm with the bound `most`, or in multiples of sigma."""

    def make(scale: float, x: FloatArray) -> Effect:
        return MAKE[kind](**{name: math.exp(_bounded(x[0], -25, math.log(most))) if log else float(x[0]) * scale})

    def problems(s: Setting) -> Iterator[Problem]:
        starts = tuple((math.log(size) if log else size,) for size in sizes)
        yield Problem(make=partial(make, s.sigma), starts=starts, steps=(0.2,))

    return problems


def _wiggling(s: Setting) -> Iterator[Problem]:
    def make(x: FloatArray) -> Effect:
        size, phase = math.hypot(x[0], x[1]) * s.sigma, math.atan2(x[1], x[0])
        return MAKE["wiggling"](amplitude_mm=size, phase_rad=phase)

    turns = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    yield Problem(make=make, starts=tuple((0.7 * math.cos(t), 0.7 * math.sin(t)) for t in turns), steps=(0.3, 0.3))


def _walk(s: Setting) -> Iterator[Problem]:
    lit = s.amplitudes[s.amplitudes > 0]
    if lit.size == 0:
        return
    reference = float(f"{math.exp(np.log(lit).mean()):.4g}")

    def make(x: FloatArray) -> Effect:
        return MAKE["amplitude_walk"](
            scale_mm=float(x[0]) * s.sigma, reference_amplitude=reference, exponent=_bounded(x[1], 0.05, 4.0)
        )

    starts = tuple((size, exponent) for size in (-0.5, 0.5) for exponent in (0.5, 1.0, 1.6))
    yield Problem(make=make, starts=starts, steps=(0.2, 0.2), other=lambda x: bool(x[1] < _FLAT))


def _drift(s: Setting) -> Iterator[Problem]:
    fastest = max(s.recorded / 100, _LEAST_FRAMES * s.interval)

    def make(x: FloatArray) -> Effect:
        tau = math.exp(_bounded(x[1], math.log(fastest), math.log(s.duration * 30)))
        reached = -math.expm1(-s.duration / tau)  # the parameter is the drift at the end, which is independent of tau
        return MAKE["temperature_drift"](amplitude_mm=float(x[0]) * s.sigma / reached, time_constant_s=tau)

    spans = {s.recorded, s.duration} if s.duration > _PAUSED * s.recorded else {s.duration}
    taus = sorted({max(part * span, 1.1 * fastest) for part in (0.1, 0.4, 1.5) for span in spans})
    starts = tuple((size, math.log(tau)) for size in (-1.0, 1.0) for tau in taus)
    yield Problem(make=make, starts=starts, steps=(0.3, 0.4), other=lambda x: bool(x[1] < math.log(_AT_ONCE * fastest)))


def _per_surface(kind: str, name: str, sizes: tuple[float, ...], *, by_time: bool) -> _Maker:
    def make(surface: str, scale: float, x: FloatArray) -> Effect:
        return MAKE[kind](surface=surface, **{name: float(x[0]) * scale})

    def problems(s: Setting) -> Iterator[Problem]:
        for seen in s.surfaces:
            scale = seen.sigma / s.duration if by_time else seen.sigma
            there = (seen.residual / seen.sigma * (2.0 if by_time else 1.0),) if seen.far else ()
            starts = tuple((v,) for v in (*sizes, *there))
            yield Problem(make=partial(make, seen.name, scale), starts=starts, steps=(0.3,))

    return problems


def _pose(s: Setting) -> Iterator[Problem]:
    """A shift; and a shift with tilts, if the plane of the surface is clearly tilted."""
    yield from _per_surface("surface_pose", "shift_mm", (-1.0, 1.0), by_time=False)(s)

    def make(surface: Surface, scales: tuple[float, float, float], x: FloatArray) -> Effect:
        shift, about_u, about_v = (float(v) * scale for v, scale in zip(x, scales, strict=True))
        return SurfacePose.tilted(surface, shift, (about_u, about_v))

    for seen in s.surfaces:
        if seen.pose is None or seen.pose.turn_nats < _TURNED_NATS or min(seen.turned_deg) <= 0:
            continue
        scales = seen.sigma, *seen.turned_deg
        there = (seen.pose.shift_mm, *seen.pose.tilts_deg)
        start = tuple(value / scale for value, scale in zip(there, scales, strict=True))
        yield Problem(make=partial(make, seen.surface, scales), starts=(start,), steps=(0.3, 0.3, 0.3))


def _multipath(s: Setting) -> Iterator[Problem]:
    """Two components: in phase, which changes the amplitude, and a quarter turn off, which changes the range."""

    def make(surface: str, unit: float, x: FloatArray) -> Effect:
        path = _bounded(math.atan2(x[1], x[0]) % (2 * math.pi) / math.pi, 0.02, 1.98) * s.turn
        share = _bounded(math.hypot(x[0], x[1]) * unit, 1e-4, 0.99)
        return MAKE["multipath"](surface=surface, share=share, extra_path_mm=path)

    for seen in s.surfaces:
        unit = min(0.2, max(0.006, 2 * math.pi * seen.sigma / s.turn))  # shifts the range by about sigma
        turns = [math.pi * path for path in (0.15, 0.35, 0.6, 0.85, 1.15, 1.5, 1.85)]
        starts = [(size * math.cos(t), size * math.sin(t)) for size in (1.5, 4.5) for t in turns]
        if seen.far:
            slope = math.tan(2 * math.pi * min(max(seen.residual / s.turn, -0.2), 0.2))
            starts += [(along / unit, (1 + along) * slope / unit) for along in (-0.3, 0.0, 0.3)]
        yield Problem(make=partial(make, seen.name, unit), starts=tuple(starts), steps=(0.3, 0.3))


def _reflection(s: Setting) -> Iterator[Problem]:
    """Two components of the phasor, in units that shift the range of a typical pixel by about sigma."""
    lit = s.amplitudes[s.amplitudes > 0]
    if lit.size == 0:
        return
    unit = max(float(np.median(lit)) * 2 * math.pi * s.sigma / s.turn, 1e-6)

    def make(x: FloatArray) -> Effect:
        size = _bounded(math.hypot(x[0], x[1]) * unit, 0, 1e6)
        return MAKE["internal_reflection"](amplitude=size, range_mm=math.atan2(x[1], x[0]) / (2 * math.pi) * s.turn)

    around = (1, 1j, -1, -1j)
    starts = tuple((z.real, z.imag) for z in (s.stray / unit, *around))
    yield Problem(make=make, starts=starts, steps=(0.3, 0.3))


def stray_phasor(
    range_mm: FloatArray, amplitude: FloatArray, residual_mm: FloatArray, sigma_mm: FloatArray, turn_mm: float
) -> complex:
    """The small phasor c that, added to every pixel's, explains most of the residuals: linear least squares.

    Parameters
    ----------
    range_mm, amplitude : (pixel,) float64
        Predicted range, mm, and amplitude.
    residual_mm : (pixel,) float64
        Measured minus predicted range, mm; NaN where it is not known.
    sigma_mm : (pixel,) float64
        Noise, mm.
    turn_mm : float
        d_u, mm.

    Returns
    -------
    complex
        To first order a pixel is moved by d_u / 2 pi Im(c exp(-2 pi i r / d_u)) / A. 0 if no pixel has an amplitude.
    """
    known = ~np.isnan(residual_mm) & (amplitude > 0)
    if math.isnan(turn_mm) or not known.any():
        return 0j
    phase = 2 * math.pi * range_mm[known] / turn_mm
    lever = turn_mm / (2 * math.pi) / (amplitude * sigma_mm)[known]
    columns = np.stack([-np.sin(phase), np.cos(phase)], axis=1) * lever[:, None]
    real, imaginary = np.linalg.lstsq(columns, residual_mm[known] / sigma_mm[known], rcond=None)[0]
    return complex(real, imaginary)


def _near_return(s: Setting) -> Iterator[Problem]:
    """From the samples before the scene; none without such samples."""
    if s.glass is None:
        return

    def make(x: FloatArray) -> Effect:
        share, range_mm, sigma_mm = (math.exp(_bounded(v, -25, 12)) for v in x)
        return MAKE["near_return"](share=share, range_mm=range_mm, sigma_mm=sigma_mm)

    yield Problem(make=make, starts=(tuple(math.log(v) for v in s.glass),), steps=(0.2, 0.05, 0.2))


def _before_the_scene(view: RecordingView) -> tuple[int, FloatArray]:
    """How many of some samples are valid, and those of a cover glass: nearer than all that the model has there."""
    m = view.mixture
    samples = view.evidence.samples[:: max(1, len(view.evidence.samples) // _GLANCE)]
    nearest = np.where(m.weight > 0, m.mean - _OUT_OF_SIGHT * m.sigma, np.inf).min(axis=(0, 1))
    prior = EFFECTS["near_return"].parameters()["range_mm"].prior
    low, high = (0.0, math.inf) if prior is None else prior.farthest
    near = (samples > low) & (samples < np.minimum(nearest, high))
    return int((samples > 0).sum()), samples[near].astype(np.float64)


def _of_glass(seen_by: Sequence[RecordingView]) -> tuple[float, float, float] | None:
    """Share, median and spread of the samples before the scene, mm; None without any."""
    counts, values = zip(*(_before_the_scene(view) for view in seen_by), strict=True)
    near = np.concatenate(values)
    if not near.size:
        return None
    middle = float(np.median(near))
    return near.size / sum(counts), middle, max(float(np.median(np.abs(near - middle))), _HALF_CELL_MM)


def _vignetting(s: Setting) -> Iterator[Problem]:  # noqa: ARG001
    def make(x: FloatArray) -> Effect:
        return MAKE["vignetting"](corner_factor=math.exp(_bounded(x[0], 0, 4)))

    yield Problem(make=make, starts=((0.05,), (0.3,), (0.8,)), steps=(0.1,))


def _dropout(s: Setting) -> Iterator[Problem]:
    """At random, and with a threshold; only if samples are lost."""
    lost = float(s.shares.mean())
    if lost <= 0:
        return

    def by_chance(x: FloatArray) -> Effect:
        return MAKE["dropout"](probability=math.exp(_bounded(x[0], -20, -0.01)))

    def weak(x: FloatArray) -> Effect:
        threshold = math.exp(x[0])
        return MAKE["dropout"](
            probability=math.exp(_bounded(x[1], -20, -0.01)),
            threshold=threshold,
            threshold_noise=threshold * math.exp(_bounded(x[2], -7, 1)),
        )

    yield Problem(make=by_chance, starts=((math.log(lost),),), steps=(0.1,))
    levels = np.quantile(s.amplitudes[s.amplitudes > 0], (0.005, 0.02, 0.06, 0.15, 0.4))
    starts = tuple(
        (math.log(level * part), math.log(rest * lost), width)
        for level in levels
        for part in (0.8, 1.0)
        for rest in (0.02, 0.5)
        for width in (-3.5, -2.0)
    )
    yield Problem(make=weak, starts=starts, steps=(0.05, 0.4, 0.4))


def _saturation(s: Setting) -> Iterator[Problem]:
    if not s.shares.any():
        return

    def make(x: FloatArray) -> Effect:
        return MAKE["saturation"](full_well_amplitude=math.exp(x[0]))

    hit = (s.shares > _MOSTLY) & (s.amplitudes > 0)
    spare = np.quantile(s.amplitudes[s.amplitudes > 0], (0.5, 0.8, 0.9, 0.95, 0.98, 0.995))
    levels = np.concatenate([np.quantile(s.amplitudes[hit], (0.0, 0.02, 0.1)) if hit.any() else spare[:0], spare])
    yield Problem(make=make, starts=tuple((math.log(level),) for level in levels), steps=(0.02,))


def _wrapping(s: Setting) -> Iterator[Problem]:
    """At the camera's own turn, because a free one absorbs an offset; only if samples can fold.

    They can if a surface is near enough to the turn, or if pixels are off by a whole turn, so closely that chance gives
    this in 1 of 20.
    """
    reach = np.where(s.mixture.lit & (s.mixture.weight > 0), s.mixture.true_range, 0.0) + 4 * s.sigma
    turns = s.residuals / s.turn
    whole = (np.rint(turns) != 0) & (np.abs(turns - np.rint(turns)) < 0.5 * _BY_CHANCE)
    if reach.max() > s.turn or whole.any():
        yield Problem(make=lambda _: MAKE["phase_wrapping"](unambiguous_range_mm=s.turn), starts=((),), steps=())


SEARCHES: dict[str, _Maker] = {
    "range_offset": _simple("range_offset", "offset_mm", (-0.3, 0.3), log=False),
    "surface_pose": _pose,
    "motion": _per_surface("motion", "velocity_mm_s", (-1.5, 1.5), by_time=True),
    "wiggling": _wiggling,
    "amplitude_walk": _walk,
    "temperature_drift": _drift,
    "scattering": _simple("scattering", "share", (0.002, 0.02, 0.1), log=True),
    "multipath": _multipath,
    "internal_reflection": _reflection,
    "near_return": _near_return,
    "phase_wrapping": _wrapping,
    "flying_pixels": _simple("flying_pixels", "probability", (0.01, 0.1, 0.6), log=True),
    "pixel_crosstalk": _simple("pixel_crosstalk", "share", (0.003, 0.03), log=True),
    "vignetting": _vignetting,
    "excess_noise": _simple("excess_noise", "factor", (0.9, 1.1, 1.5), log=True),
    "outliers": _simple("outliers", "probability", (0.0005, 0.01), log=True, most=_MOST_OUTLIERS),
    "dropout": _dropout,
    "saturation": _saturation,
}


def setting(likelihood: Likelihood, mixture: Mixture) -> Setting:
    """The data that determine the starts, for a mixture."""
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    seen_by = list(views(likelihood, mixture, whole))
    surfaces = {s.name: s for view in seen_by for s in view.scene.model.surfaces}
    pixels = [_main(view) for view in seen_by]
    lit, sigma, mean, name, amplitude, lost, median = (np.concatenate(values) for values in zip(*pixels, strict=True))
    seen = []
    for surface in likelihood.scene.names:
        own = lit & (name == surface)
        if own.sum() >= _LEAST_PIXELS:
            away = (median - mean)[own & ~np.isnan(median)]
            residual = float(np.median(away)) if away.size else 0.0
            typical = float(np.median(sigma[own]))
            pose, turned = _plane_of(seen_by, surfaces[surface], typical)
            seen.append(
                MeasuredSurface(
                    surface=surfaces[surface], sigma=typical, residual=residual, pose=pose, turned_deg=turned
                )
            )
    phased = likelihood.scene.model.sensor.modulation_frequency_hz is not None
    turn = likelihood.scene.model.sensor.turn_mm("reconcile") if phased else math.nan
    interval = float(np.median(np.abs(np.diff(likelihood.evidence.time_s))))
    return Setting(
        mixture=mixture,
        sigma=float(np.median(sigma[lit])) if lit.any() else float(np.median(sigma)),
        turn=turn,
        duration=max(float(likelihood.evidence.time_s.max()), 1e-3),
        recorded=max(interval * max(f.stop - f.start for f in likelihood.evidence.recordings), 1e-3),
        interval=interval,
        surfaces=tuple(seen),
        amplitudes=amplitude,
        shares=lost,
        residuals=(median - mean)[lit & ~np.isnan(median)],
        stray=stray_phasor(mean[lit], amplitude[lit], (median - mean)[lit], sigma[lit], turn),
        glass=_of_glass(seen_by),
    )


def _plane_of(
    seen_by: Sequence[RecordingView], surface: Surface, sigma: float
) -> tuple[PlanePose | None, tuple[float, float]]:
    """The pose of a surface from its pixels' medians, in the first recording that shows it; tilts of one sigma."""
    for view in seen_by:
        lit, _, mean, names, _, _, median = _main(view)
        own = lit & (names == surface.name) & ~np.isnan(median)
        if own.sum() < _LEAST_PIXELS:
            continue
        beams = view.scene.beams[own]
        known = np.full(int(own.sum()), _KNOWN_OF_MEDIAN * min(len(view.evidence.samples), _GLANCE) / sigma**2)
        pose = measured_pose(surface, beams, (median - mean)[own], known)
        slopes = np.quantile(np.abs(range_slopes(surface, beams)[:, 1:]), _AT_THE_EDGE, axis=0)
        about_u, about_v = (sigma / float(v) if v > _LEAST_LEVER else 0.0 for v in slopes)
        return pose, (about_u, about_v)
    return None, (0.0, 0.0)


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


def problems(kind: str, likelihood: Likelihood, mixture: Mixture) -> list[Problem]:
    """The searches of a kind; none if the camera or the scene cannot have it."""
    if EFFECTS[kind].acts_on_phase or kind == "phase_wrapping":
        try:
            refuse_without_phase(kind, likelihood.scene.model.sensor)
        except ValueError:
            return []
    found = SEARCHES.get(kind, _declared(kind))(setting(likelihood, mixture))
    return [_plausible(problem) for problem in found]


def _plausible(problem: Problem) -> Problem:
    """The search; vectors with numbers that no camera has, by their prior, count as another effect."""

    def other(x: FloatArray) -> bool:
        try:
            return (problem.other is not None and problem.other(x)) or not problem.make(x).plausible()
        except ValueError:
            return True

    return replace(problem, other=other)


def _declared(kind: str) -> _Maker:
    """All numbers from their typical sizes: logarithms for numbers of one sign, multiples of the size for others."""
    parameters = EFFECTS[kind].parameters().values()
    free = [p for p in parameters if p.holds is Holds.NUMBER and not math.isnan(p.typical[0])]
    sizes = [math.sqrt(p.typical[0] * p.typical[1]) for p in free]
    logs = [p.low >= 0 for p in free]

    def make(surface: dict[str, str], x: FloatArray) -> Effect:
        values = [math.exp(_bounded(v, -50, 50)) if log else v for v, log in zip(x, logs, strict=True)]
        return MAKE[kind](
            **{p.name: float(v) * size for p, v, size in zip(free, values, sizes, strict=True)}, **surface
        )

    of_surface = any(p.holds is Holds.SURFACE for p in parameters)
    ways = list(product(*(((0.0,) if log else (-1.0, 1.0)) for log in logs)))

    def problems(s: Setting) -> Iterator[Problem]:
        for own in ({"surface": seen.name} for seen in s.surfaces) if of_surface else ({},):
            yield Problem(make=partial(make, own), starts=tuple(ways), steps=(0.3,) * len(free))

    return problems
