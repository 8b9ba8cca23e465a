"""What all sets of effects of one search share: the recordings, the model as given, the laws, and the prices.

Here too: biases in tenths of the time, and how far a memory of the noise lets independent samples overstate what
they tell.
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.likelihood.hidden_fits import find_lattice
from tofmix.reconciliation.likelihood.hidden_states import begin
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part, SurfaceShifts
from tofmix.reconciliation.likelihood.memory import inflation, memory_of, sees_one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.one.columns import TENTHS, ColumnMaker, by_tenth
from tofmix.reconciliation.one.coordinates import Key, Law, laws
from tofmix.reconciliation.one.scene_errors import Edges, SceneErrors
from tofmix.reconciliation.one.static_errors import DISCREPANCY, LEAST_INFORMATION, StaticErrors, across_surface, hats
from tofmix.reconciliation.one.steps_kernel import DistinctValues
from tofmix.reconciliation.parameters.searches import search_facts
from tofmix.reconciliation.settings import Settings, fit_part
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.base import with_hidden
from tofmix.simulation.effects.hidden import (
    DisturbedFrames,
    PatternSpreads,
    PixelBias,
    PixelValue,
    RangeStep,
    RememberedNoise,
)
from tofmix.simulation.effects.search import OwnProblems

UNIFORM = 3**-0.5
"""Standard deviation of an error that may be anything up to the tolerance, over the tolerance."""

SORTS = (PixelValue, RangeStep, DisturbedFrames, PixelBias, RememberedNoise)
"""Hidden states with a fit of their own; a set has one of each sort."""

_NOISE = 0.1  # of the tolerance: accepted relative error of sigma


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OneRecording:
    """One recording, with the main surface of each pixel by the model as given.

    Parameters
    ----------
    view : RecordingView
        The recording, all of its frames.
    surface : (pixel,) int64
        Number of the main surface.
    tenths : list of (n,) int64
        Frames of each tenth of the time, by their numbers among all recordings.
    values : DistinctValues
        Of its samples.
    scene : SceneErrors
        Errors of its scene.
    lost : (pixel,) int64
        Lost samples of each pixel.
    """

    view: RecordingView
    surface: IntArray
    tenths: list[IntArray]
    values: DistinctValues
    scene: SceneErrors
    lost: IntArray

    @property
    def wandering(self) -> "OneRecording":
        """The same where all means wander."""
        return replace(self, scene=self.scene.wandering())

    @property
    def part(self) -> Part:
        """All of it."""
        return self.view.part_of_all


class _Rows:
    """A sparse matrix (row, place), made row by row."""

    def __init__(self, places: int) -> None:
        self._places, self._at, self._values = places, [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
        self._ends = [0]

    def add(self, at: IntArray, values: FloatArray) -> None:
        """Add a row with values (n,) at places (n,)."""
        self._at.append(at)
        self._values.append(values)
        self._ends.append(self._ends[-1] + values.size)

    @property
    def made(self) -> csr_array:
        """The matrix."""
        shape = (len(self._ends) - 1, self._places)
        return csr_array((np.concatenate(self._values), np.concatenate(self._at), np.array(self._ends)), shape)


class SearchTask:
    """The recordings, the model as given, the laws, and the prices.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    settings : Settings
        Options.

    Attributes
    ----------
    null : ModelState
        The model as given, without biases of pixels.
    mixture : Mixture
        Its prediction.
    recordings : tuple of OneRecording
        All of them.
    lit, single : (recording, pixel) bool
        Pixels whose main component is light of a surface; those that also see only one surface.
    low : (k, recording x pixel) sparse float64
        Errors of means that pixels have in common, mm, with unit priors: those of any model, of each surface a shift,
        two tilts and a smooth error, in pixels that see it alone; and those of a measured scene.
    own_variance_mm2 : (pixel,) float64
        Variance of the mean of each pixel in a measured scene; 0 where the scene is given.
    laws : tuple of Law
        All laws that may be members.
    hidden : tuple of type of Effect
        Kinds with a hidden state of one of `SORTS`.
    low_width : (k, recording x pixel) sparse float64
        The model's own errors of the logarithm of sigma, with unit priors: one common, and one of each surface.
    width_variance : (recording x pixel,) float64
        Variance of the logarithm of each pixel's own width.
    given_kinds : set of str
        Kinds that the model has.
    given : PatternSpreads
        Spreads of the model's own pattern; zeros without one.
    passes : int
        Passes over the samples so far.
    accepted : float
        Accepted error of the scene, in sigma.
    """

    def __init__(self, likelihood: Likelihood, settings: Settings) -> None:
        self.likelihood, self.settings, self.passes = likelihood, settings, 0
        self.accepted = settings.accepted(likelihood)
        frames, pixels = likelihood.evidence.shape
        self.part: Part = (np.arange(frames), np.arange(pixels))
        begun = begin(likelihood, fit_part(likelihood, settings)[0], self.accepted)
        self.null = replace(begun, pixel_bias=np.zeros(pixels), log_width=np.zeros_like(begun.log_width))
        self.mixture = likelihood.mixture(self.null)
        self.recordings = tuple(self._recording(view) for view in views(likelihood, self.mixture, self.part))
        mixtures = [r.view.mixture for r in self.recordings]
        self.lit: BoolArray = np.stack([m.of_main(m.lit).astype(bool) for m in mixtures])
        self.single: BoolArray = np.stack([sees_one_surface(m) for m in mixtures]) & self.lit
        self._of_surfaces = list(self._model_errors())
        self.low = self._low()
        self.own_variance_mm2 = self.recordings[0].scene.own_variance_mm2
        self.columns = ColumnMaker(likelihood, self.null, self.part)
        own = [EFFECTS[kind] for kind in settings.kinds]
        self.hidden = tuple(kind for kind in own if isinstance(kind.hidden, SORTS))
        searched = [k.kind for k in own if k not in self.hidden or isinstance(k, OwnProblems)]
        self.laws = tuple(self._laws(searched))
        kinds = {law.name: law.kind for law in self.laws} | {(kind.kind, ""): kind for kind in self.hidden}
        self._basic = {name for name, kind in kinds.items() if kind.basic is not None}
        self._others = max(len(kinds) - len(self._basic), 1)
        self.low_width = self._noise_errors()
        spread = likelihood.scene.model.sensor.noise.width_spread
        of_scene = np.concatenate([r.scene.log_width_variance for r in self.recordings])
        self.width_variance = spread**2 + of_scene
        self.given_kinds = {e.kind for e in likelihood.scene.effects}
        self.given = next((h.spreads(e) for e, h in with_hidden(self.null.given, PixelBias)), PatternSpreads(0, 0, 0))

    def price_nats(self, keys: Collection[Key]) -> float:
        """Price of some members.

        Without effects, a Bayes factor of x comes up with a probability of at most 1 / x (Markov). So noise adds one of
        m effects to at most a share alpha / 2 of recordings if each costs log(2 m / alpha). The errors that every model
        has share one half of alpha, all other effects the other half.
        """
        half = 0.5 * self.settings.alpha
        basic = sum(key[:2] in self._basic for key in keys)  # counted, as sums over a set depend on its order
        others = len(keys) - basic
        return basic * math.log(max(len(self._basic), 1) / half) + others * math.log(self._others / half)

    def _recording(self, view: RecordingView) -> OneRecording:
        m = view.mixture
        tenths = [f for f in np.array_split(view.part_of_all[0], TENTHS) if f.size]
        values = DistinctValues.of(view.evidence.samples)
        errors = SceneErrors.of(self.null.errors, m, view.part[0].size, memory_of(self.null))
        lost = np.asarray((view.evidence.samples == 0).sum(axis=0), dtype=np.int64)
        return OneRecording(
            view=view, surface=m.of_main(m.surface), tenths=tenths, values=values, scene=errors, lost=lost
        )

    def _laws(self, kinds: list[str]) -> list[Law]:
        like = self.likelihood
        taken = {(e.kind, getattr(e, "surface", "")) for e in like.scene.effects}
        facts = search_facts(like, self.mixture)
        # the way of what moves takes in what other effects do, so it is uneven where there is no other way: the surface
        # goes far, or moves within the reference, and widths hold its way
        self.moves_far = any(facts.goes_far(seen, seen.pixels if like.scene.has_way else 1) for seen in facts.surfaces)
        found = laws(kinds, facts, self.columns.facts, taken, like.scene.model.sensor)
        lost = [k for k in kinds if EFFECTS[k].loses_by_noise]
        return [law for law in found if law.kind.kind not in lost or self._loses]

    @cached_property
    def _loses(self) -> bool:
        """Whether samples are lost beyond those that the model loses."""
        return bool((self.likelihood.evidence.samples == 0).mean() > self.mixture.invalid.mean())

    def _model_errors(self) -> Iterator[tuple[int, int, FloatArray]]:
        """The errors of each surface: its recording, its number, and their columns (k, pixel) over the image, mm."""
        rows, cols = self.likelihood.evidence.image
        row, col = np.divmod(np.arange(rows * cols), cols)
        for number, recording in enumerate(self.recordings if self.accepted else ()):
            m = recording.view.mixture
            sigma = m.of_main(m.sigma)
            for surface in np.unique(recording.surface[self.single[number]]):
                own = self.single[number] & (recording.surface == surface)
                error = self.accepted * UNIFORM * float(np.median(sigma[own]))
                u, v = across_surface(col, own), across_surface(row, own)
                smooth = [DISCREPANCY * error * s for s in (u, v, *hats(u, v))]
                yield number, int(surface), np.stack([np.full(own.size, error), *smooth])

    def _low(self) -> csr_array:
        """The errors of means that pixels have in common, of surfaces and of what a measured scene has in common."""
        pixels, out = self.lit.shape[1], _Rows(self.lit.size)
        for number, surface, columns in self._of_surfaces:
            alone = np.flatnonzero(self._alone(number, surface))
            for column in columns:
                out.add(number * pixels + alone, column[alone])
        for number, recording in enumerate(self.recordings):
            for column in recording.scene.columns_mm:
                out.add(number * pixels + np.arange(pixels), column)
        return out.made

    def shifts(self, coordinates: FloatArray, near: SurfaceShifts | None = None) -> SurfaceShifts | None:
        """How far surfaces are off in the pixels that they share, by the errors that other pixels tell.

        Parameters
        ----------
        coordinates : (k,) float64
            Of the columns of `low`.
        near : SurfaceShifts, optional
            Those of coordinates nearby, whose shares are taken.
        """
        shared = self._shared
        if not shared.size or not self._of_surfaces:
            return None
        last = 1 + max(surface for _, surface, _ in self._of_surfaces)
        shift = np.zeros((len(self.recordings), last + 1, shared.size))
        place = 0
        for number, surface, columns in self._of_surfaces:
            own = coordinates[place : place + len(columns)]
            shift[number, surface] = np.where(self.single[number, shared], 0.0, own @ columns[:, shared])
            place += len(columns)
        return SurfaceShifts(shared, shift, self._shares(coordinates) if near is None else near.shares)

    def likely_shifts(self, coordinates: FloatArray, state: ModelState, predicted: Mixture) -> SurfaceShifts | None:
        """How far surfaces are off, as of `shifts`; their shares change only if samples bear it out.

        Ranges may be off by another cause than the place of a surface.

        Parameters
        ----------
        coordinates : (k,) float64
            Of the columns of `low`.
        state, predicted
            A model, and what its effects predict.
        """
        moved, like = self.shifts(coordinates), self.likelihood
        if moved is None or not any(shares is not None and shares[1].any() for shares in moved.shares):
            return moved
        still = moved._replace(shares=(None,) * len(moved.shares))
        states = [replace(state, shifts=shifts) for shifts in (moved, still)]
        part = self.part[0], moved.pixels
        there, here = (like.sums(like.with_errors(predicted, s), s, part).total for s in states)
        return moved if there > here else still

    def _shares(self, coordinates: FloatArray) -> tuple[tuple[IntArray, FloatArray] | None, ...]:
        """The shares that change where surfaces are off, as of `SurfaceShifts`."""
        shift = [np.zeros(len(r.view.scene.names) + 1) for r in self.recordings]  # the last: layers of no surface
        place = 0
        for number, surface, columns in self._of_surfaces:
            own = coordinates[place : place + len(columns)] @ columns
            shift[number][surface] = own[self._alone(number, surface)].mean()
            place += len(columns)
        return tuple(
            None if edges is None else (edges.surface, edges.change(mm[:-1]))
            for edges, mm in zip(self._edges, shift, strict=True)
        )

    def _alone(self, number: int, surface: int) -> BoolArray:
        return np.asarray(self.single[number] & (self.recordings[number].surface == surface))

    @cached_property
    def _shared(self) -> IntArray:
        """Pixels that surfaces share in any recording."""
        return np.flatnonzero((self.lit & ~self.single).any(axis=0))

    @cached_property
    def _edges(self) -> tuple[Edges | None, ...]:
        """Of each recording; none of a measured scene, whose surfaces keep their shares."""
        return tuple(
            None
            if r.view.scene.model.scene is not None
            else Edges.of(r.view.scene.model, self._shared, [self._alone(n, s) for s in range(len(r.view.scene.names))])
            for n, r in enumerate(self.recordings)
        )

    def _noise_errors(self) -> csr_array:
        """Half of the variance is common to all surfaces, as of a curve that is wrong, and half is of each surface.

        All widths of a measured scene have another error in common, and those of each surface one more.
        """
        size = _NOISE * self.accepted * UNIFORM * math.sqrt(0.5)
        pixels, out = self.lit.shape[1], _Rows(self.lit.size)
        common = np.array([r.scene.common_log_width for r in self.recordings])[:, None] * self.lit
        for everywhere in (self.lit * size, common):
            if everywhere.any():
                out.add(np.arange(self.lit.size), np.asarray(everywhere.ravel(), dtype=np.float64))
        for number, recording in enumerate(self.recordings):
            for surface in np.unique(recording.surface[self.lit[number]]):
                own = np.flatnonzero(self.lit[number] & (recording.surface == surface))
                for values in (size * np.ones(own.size), recording.scene.lent_log_width[own]):
                    if values.any():
                        out.add(number * pixels + own, values)
        return out.made

    def width_errors(self, information: FloatArray) -> StaticErrors:
        """The covariance of log widths, all recordings in one row, for some information (recording, pixel) about each.

        A recording has its own widths of single pixels.
        """
        row = information.reshape(1, -1)
        return StaticErrors.of(self.low_width, row, row.shape, more_variance=self.width_variance)

    def known_with_scene(self, information: FloatArray) -> FloatArray:
        """Information (..., pixel) about biases of the camera, 1/mm2, by that about biases from the measured scene."""
        return np.asarray(information / (1.0 + information * self.own_variance_mm2))

    @cached_property
    def step_mm(self) -> float | None:
        """The step of the stored values, mm; None if there is none."""
        return find_lattice(self.likelihood.evidence, self.null)

    @cached_property
    def sigma_mm(self) -> float:
        """Typical noise."""
        sigma = [
            r.view.mixture.of_main(r.view.mixture.sigma)[lit] for r, lit in zip(self.recordings, self.lit, strict=True)
        ]
        every = np.concatenate(sigma)
        return float(np.median(every)) if every.size else float(np.median(self.mixture.of_main(self.mixture.sigma)))

    def split(self, mixture: Mixture) -> list[Mixture]:
        """The mixture of each recording."""
        return [mixture.of_frames(r.view.frames) for r in self.recordings]


def hidden_of(effects: tuple[Effect, ...], sort: type) -> Effect | None:
    """The effect with a hidden state of a sort; None without one."""
    return next((e for e in effects if isinstance(e.hidden, sort)), None)


_NUDGE = 0.3  # of sigma, for slopes of quantised samples
_LEAST = 0.05  # of the information of independent samples, below which quantised samples tell nothing of a bias


def observed(task: SearchTask, mixture: Mixture) -> tuple[FloatArray, FloatArray]:
    """Mean, mm, and log width (tenth, recording, pixel) of the main surfaces of the given model."""
    most = max(len(r.tenths) for r in task.recordings)
    mean, width = np.full((2, most, *task.lit.shape), np.nan)
    for number, recording in enumerate(task.recordings):
        own = slice(len(recording.tenths)), number
        mean[own], width[own] = by_tenth(mixture, recording.tenths, recording.surface)
    return mean, width


def biases_by_tenth(
    task: SearchTask, state: ModelState, mixture: Mixture, bias_mm: FloatArray, used: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Bias, mm, and information, 1/mm2, (tenth, recording, pixel) by a step of Newton's from that of all frames.

    Parameters
    ----------
    task, state, mixture
        The recordings, the model, and its prediction.
    bias_mm, used : (recording, pixel)
        Bias of each pixel by all frames, and which pixels are asked for.
    """
    most = max(len(r.tenths) for r in task.recordings)
    shifts, told = np.zeros((most, *used.shape)), np.zeros((most, *used.shape))
    for number, recording in enumerate(task.recordings):
        for tenth, frames in enumerate(recording.tenths):
            slope, information = _slope_of(task, state, mixture, (frames, task.part[1]), bias_mm[number])
            good = used[number] & (information > LEAST_INFORMATION)
            shifts[tenth, number] = bias_mm[number] + np.where(
                good, slope / np.maximum(information, LEAST_INFORMATION), 0.0
            )
            told[tenth, number] = np.where(good, information, 0.0)
        task.passes += 1
    return shifts, told


def _slope_of(
    task: SearchTask, state: ModelState, mixture: Mixture, part: Part, bias: FloatArray
) -> tuple[FloatArray, FloatArray]:
    like = task.likelihood
    here = like.sums(mixture, state, part, bias=bias).by_pixel
    if mixture.step <= task.sigma_mm:
        return here[:, 1], here[:, 2]
    nudge = _NUDGE * task.sigma_mm
    up, down = (like.sums(mixture, state, part, bias=bias + d).by_pixel[:, 1] for d in (nudge, -nudge))
    exact = (down - up) / (2 * nudge)
    return here[:, 1], np.where(exact > _LEAST * here[:, 2], exact, 0.0)


def overstated(task: SearchTask, state: ModelState, mixture: Mixture) -> FloatArray:
    """Factor (recording, pixel) by which independent samples would overstate the information about a bias."""
    if not memory_of(state):
        return np.ones(task.lit.shape)
    return np.stack([inflation(task.likelihood, mixture, state, r.part) for r in task.recordings])


def overstated_width(of_bias: FloatArray) -> FloatArray:
    """The same of the information about a width, for noise of which each sample remembers the last one.

    With a coefficient rho, the variance of a mean grows by (1 + rho) / (1 - rho), that of a mean square by
    (1 + rho^2) / (1 - rho^2).
    """
    return (of_bias**2 + 1.0) / (2.0 * of_bias)
