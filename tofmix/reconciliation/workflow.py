"""Run the steps compare, localise, search and verify, and collect the result.

Use `reconcile` for samples in memory; `tofmix.cli.reconcile` does the same for files.

`warm_up` compiles the kernels of reconciliation by using each once.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.reconciliation.comparison.compare import Compared, Place, localise
from tofmix.reconciliation.evidence import ChangedPart, Evidence, make_evidence
from tofmix.reconciliation.found import Added, Ledger, Named, TriedEffect, WeighedSet
from tofmix.reconciliation.left_out import places, without_changes, without_others
from tofmix.reconciliation.likelihood.hidden_fits import fit_bursts
from tofmix.reconciliation.likelihood.hidden_states import latent_states
from tofmix.reconciliation.likelihood.joint import Recording, joint_likelihood, renamed
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.memory import (
    RandomValues,
    memory_gain,
    memory_gain_at_own_widths,
    predicted_noise,
)
from tofmix.reconciliation.one import outcome
from tofmix.reconciliation.one.steps_kernel import DistinctValues, by_values
from tofmix.reconciliation.parameters.pattern_errors import latent_errors
from tofmix.reconciliation.parameters.polish import numbers_of
from tofmix.reconciliation.parameters.standard_errors import standard_errors
from tofmix.reconciliation.settings import Settings, fit_part
from tofmix.reconciliation.verification.considered import Alias, aliases, considered
from tofmix.reconciliation.verification.next_steps import next_steps
from tofmix.reconciliation.verification.verify import Verified, far_trends, verify
from tofmix.simulation.casting.polygon_cast import PolygonCaster
from tofmix.simulation.effects.base import Effect, with_hidden
from tofmix.simulation.effects.hidden import RememberedNoise
from tofmix.simulation.effects.parameter import Holds, PixelMap
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface
from tofmix.wording import rounded


def warm_up(model: Model) -> None:
    """Compile the kernels of `reconcile`, except those of simulation, or load them from the cache.

    Parameters
    ----------
    model : Model
        Any one.
    """
    PolygonCaster(model.sensor).cast(model)  # 6 x 6 pixels are too wide for it
    model = replace(model, sensor=replace(model.sensor, rows=6, cols=6))
    frames = 20  # as few as are taken
    range_mm = np.random.default_rng(1).normal(1500.0, 10.0, (frames, 6, 6)).astype(np.float32)
    likelihood = joint_likelihood([(model, make_evidence(model, range_mm))])
    state, mixture = likelihood.start(), likelihood.scene.mixture()
    everything = np.arange(frames), np.arange(36)
    likelihood.sums(mixture, state, everything)
    stepped = replace(mixture, step=7.0)
    likelihood.sums(stepped, state, everything)  # a lattice: sample by sample
    by_values(DistinctValues.of(likelihood.evidence.samples), stepped, np.zeros(36))
    likelihood.scores(state, everything, 1)
    fit_bursts(likelihood, mixture, state, everything)
    alike = RandomValues(share=np.zeros(36), below=np.zeros(36), density=np.ones(36))
    scores = likelihood.scores(state, everything, 1)
    for gain in (memory_gain, memory_gain_at_own_widths):
        gain(likelihood, scores, mixture, everything, 0.5)
    predicted_noise(np.zeros((frames, 36)), 0.5, np.ones(36), alike)


DONE = ("agree", "explained")
"""Verdicts that leave nothing to explain."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedEffect:
    """An effect that the measurement has and the model lacks.

    Parameters
    ----------
    effect : Effect
        With its parameters; maps are named by a path in the model's folder.
    stderr : dict
        Standard errors of its numbers.
    heldout_gain_nats : float
        Gain on held-out data.
    recordings : tuple of int
        Recordings in which it acts, from 0. An effect of a surface acts only in recordings with this surface.
    """

    effect: Effect
    stderr: dict[str, float]
    heldout_gain_nats: float
    recordings: tuple[int, ...] = (0,)

    @property
    def parameters(self) -> dict[str, Any]:
        """Its parameters in the model file."""
        values: dict[str, Any] = {}
        for name, parameter in self.effect.parameters().items():
            value = getattr(self.effect, name)
            if value in (None, ()) or (value == parameter.default and name not in self.stderr):
                continue
            key = parameter.key
            values[key] = value.path if isinstance(value, PixelMap) else value
            if isinstance(value, float | int):
                values[key] = rounded(float(value), 8)
            elif parameter.holds is Holds.SINES:
                values[key] = [[rounded(float(number), 8) for number in sine] for sine in value]
        return values if "map" not in values else {"map": values["map"]}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reconciliation:
    """The outcome.

    Parameters
    ----------
    models : tuple of Model
        As given, one for each recording.
    named : tuple of NamedEffect
        Effects that were found.
    where : tuple of Place
        Places where the model as given disagrees. If effects explain a part, places of the refined model come first.
    added, verified
        Results of the search and of the verification.
    considered : tuple of WeighedSet
        The sets of effects that were weighed: the named one first, then its aliases, then the next best.
    changed : tuple of ChangedPart
        Parts of a measured scene that have changed.
    is_complete : bool
        Whether the search came to its end; if not, the names are the best so far.
    next_steps : tuple of str
        Next steps, the most useful first.
    suggested : tuple of (int, Effect)
        Effects that the next steps advise to add, with their recordings, from 0.
    suggested_surfaces : tuple of (int, Surface)
        Surfaces that the next steps advise to add, likewise.
    measured_noise : bool
        Whether the models have measured noise in place of their own.
    """

    models: tuple[Model, ...]
    named: tuple[NamedEffect, ...]
    where: tuple[Place, ...]
    left: tuple[Place, ...]
    added: Added
    verified: Verified
    considered: tuple[WeighedSet, ...] = ()
    is_complete: bool = True
    changed: tuple[ChangedPart, ...] = ()
    next_steps: tuple[str, ...] = ()
    suggested: tuple[tuple[int, Effect], ...] = ()
    suggested_surfaces: tuple[tuple[int, Surface], ...] = ()
    measured_noise: bool = False

    @property
    def aliases(self) -> tuple[Alias, ...]:
        """Explanations that the recording cannot separate."""
        return aliases(self.considered, named=bool(self.named))

    @property
    def has_advice(self) -> bool:
        """Whether the next steps advise to add something to a model."""
        return bool(self.suggested or self.suggested_surfaces)

    def advised(self, recording: int) -> tuple[NamedEffect, ...]:
        """The effects of the suggested model of one of the recordings, from 0: named ones, and advised ones."""
        more = (NamedEffect(effect=e, stderr={}, heldout_gain_nats=0.0) for k, e in self.suggested if k == recording)
        return (*self.acting(recording), *more)

    def acting(self, recording: int) -> tuple[NamedEffect, ...]:
        """The effects that act in one of the recordings, from 0."""
        return tuple(n for n in self.named if recording in n.recordings)

    @property
    def candidates(self) -> tuple[TriedEffect, ...]:
        """Candidates of the first round, the best of each kind, best first."""
        best: dict[str, TriedEffect] = {}
        for candidate in self.added.first:
            best.setdefault(candidate.kind, candidate)
        return tuple(best.values())

    @property
    def places_of_changes(self) -> list[Place]:
        """Those of `where` that are parts of the scene that have changed."""
        return places(self.changed)

    def as_dict(self) -> dict[str, Any]:
        """The contents of `gap.json`."""
        v = self.verified
        return {
            "verdict": v.verdict,
            "noise": "measured" if self.measured_noise else "model",
            "effects": [self._effect(n) for n in self.acting(0)],
            **self._also(),
            "changed": [part.as_dict() for part in self.changed],
            "where": [_place(p) | self._in_recording(p.recording) for p in self.where],
            "left": [_place(p) | self._in_recording(p.recording) for p in self.left],
            "candidates": [
                {"kind": c.kind, "heldout_gain_nats": rounded(c.gain), "parameters": c.parameters}
                for c in self.candidates
            ],
            "aliases": [_alias(group) for group in self.aliases],
            "panel": [line | self._in_recording(number) for number, line in _panel(v.before, v.after, v.floor)],
            "gap": {
                "before": rounded(v.before.gap),
                "after": rounded(v.after.gap),
                "floor": rounded(v.floor.gap),
                "closed": None if v.closed is None else rounded(v.closed),
            },
            "considered": [_considered(weighed) for weighed in self.considered],
            "next_steps": list(self.next_steps),
            "complete": self.is_complete,
        }

    def _effect(self, named: NamedEffect) -> dict[str, Any]:
        said = {
            "kind": named.effect.kind,
            "parameters": named.parameters,
            "stderr": _rounded(named.stderr),
            "heldout_gain_nats": rounded(named.heldout_gain_nats),
        }
        return said | ({"recordings": [k + 1 for k in named.recordings]} if len(self.models) > 1 else {})

    def _also(self) -> dict[str, Any]:
        """Effects that do not act in the first recording; `effects` lists the others."""
        others = [
            {"recording": k + 1, "effects": [self._effect(n) for n in self.acting(k) if 0 not in n.recordings]}
            for k in range(1, len(self.models))
        ]
        return {"also": others} if others else {}

    def _in_recording(self, number: int) -> dict[str, Any]:
        """The number of the recording, from 1, if there are several."""
        return {"recording": number + 1} if len(self.models) > 1 else {}


def _named_effects(names: Sequence[Named]) -> list[dict[str, str]]:
    return [{"kind": kind} | ({"surface": of} if of else {}) for kind, of in names]


def _considered(weighed: WeighedSet) -> dict[str, Any]:
    return {
        "effects": _named_effects(weighed.names),
        "evidence_nats": round(weighed.evidence_nats, 1) + 0.0,
        "why_not": weighed.why_not,
    }


def _alias(alias: Alias) -> dict[str, Any]:
    return {
        "kinds": alias.kinds,
        "gains": [round(g, 1) + 0.0 for g in alias.gains],
        "separate_by": alias.separate_by,
        "effects": [_named_effects(names) for names in alias.sets],
    }


def _place(place: Place) -> dict[str, Any]:
    return {
        "axis": place.axis,
        "interval": [rounded(x) for x in place.interval],
        "statistic": place.statistic,
        "size": rounded(place.size),
        "unit": place.unit,
        "p_value": rounded(place.p_value, 3),
    }


def _panel(before: Compared, after: Compared, floor: Compared) -> list[tuple[int, dict[str, Any]]]:
    now, chance = ({c.name: c.distance for c in part.curves} for part in (after, floor))
    return [
        (
            c.recording,
            {
                "statistic": c.statistic,
                "axis": c.axis,
                "before": rounded(c.distance),
                "after": rounded(now.get(c.name, 1.0)),
                "floor": rounded(chance.get(c.name, 1.0)),
            },
        )
        for c in before.curves
    ]


def _rounded(values: dict[str, float]) -> dict[str, float]:
    return {name: rounded(v, 3) for name, v in values.items()}


def reconcile(
    model: Model,
    evidence: Evidence,
    settings: Settings,
    tick: Callable[[str], None] = lambda _: None,
    *,
    also: Sequence[Recording] = (),
    ledger: Ledger | None = None,
) -> Reconciliation:
    """Find the effects that a model lacks, from one recording or from several of one camera.

    Parameters
    ----------
    model : Model
        The model; its own effects stay.
    tick : callable
        Called with each kind that was tried.
    also : sequence of (Model, Evidence)
        Further recordings of the same camera, each with the model of its scene. Effects of the camera have the same
        parameters in all.
    ledger : Ledger, optional
        Gets each set of effects that is weighed, and may end the search between two sets.

    Returns
    -------
    Reconciliation
        The same for the same seed.

    Raises
    ------
    BadInputError
        If the models' cameras differ, or one has a memory and a background.
    """
    recordings = (without_others(*without_changes(model, evidence)),) if not also else ((model, evidence), *also)
    models = tuple(model for model, _ in recordings)
    for given in models:
        _refuse_what_no_prediction_takes(given)
    likelihood = joint_likelihood(recordings)
    ledger = Ledger() if ledger is None else ledger
    added, verified = outcome.named(likelihood, settings, _Steps(settings.kinds, tick).done, ledger)
    if verified.verdict != "agree" and not ledger.ends():
        own = outcome.better_own_effect(recordings, added, settings)
        if own is not None:
            verified = verify(likelihood, added, settings, own)
    where: tuple[Place, ...] = ()
    if verified.verdict != "agree":
        changes = places(likelihood.evidence.changed)
        where = (
            *changes,
            *far_trends(likelihood, verified.start, settings.alpha),
            *localise(verified.before, settings.alpha),
        )
    left = tuple(localise(added.panel, settings.alpha)) if verified.verdict != "agree" else ()
    if verified.verdict == "partly_explained":
        where = (*left, *where)
    named = tuple(_placed(n, likelihood, models) for n in _named(likelihood, added, verified, settings))
    weighed = considered(added, verified, ledger)
    found = Reconciliation(
        models=models,
        named=named,
        where=where,
        left=left,
        added=added,
        verified=verified,
        considered=weighed,
        is_complete=ledger.is_complete,
        changed=likelihood.evidence.changed,
    )
    advice = next_steps(likelihood, added, verified, found.aliases, settings)
    suggested = tuple((k, _of_model(effect, likelihood, models, k)) for k, effect in advice.suggested)
    return replace(found, next_steps=advice.steps, suggested=suggested, suggested_surfaces=advice.surfaces)


def _of_model(effect: Effect, likelihood: Likelihood, models: tuple[Model, ...], recording: int) -> Effect:
    """The effect with the name that its surface has in the model of one recording."""
    scene = likelihood.scene.members[recording]
    pairs = zip(models[recording].surfaces, scene.model.surfaces, strict=True)
    return renamed(effect, {t.name: s.name for s, t in pairs})


def _refuse_what_no_prediction_takes(model: Model) -> None:
    """Refuse a background together with a memory: a random value has no memory, and no sample is marked as random.

    So scores are not normal, given the scores of the frame before. An `outlier_probability` is too small for this to
    matter.
    """
    remembered, background = next(with_hidden(model.effects, RememberedNoise), None), model.sensor.noise.background
    if background is None or remembered is None:
        return
    effect, hidden = remembered
    share, memory = float(np.mean(background)), hidden.coefficient(effect)
    both = f"a background of {100 * share:.2g} % beside {effect.kind} of {memory:.2g}"
    if model.scene is not None:
        raise BadInputError(
            f"reference: reconcile has no prediction for {both}; if the camera filters its ranges over time, switch the"
            " filter off, else give a model of the scene"
        )
    raise BadInputError(f"[sensor.noise]: background: reconcile has no prediction for {both}; leave out one of them")


class _Steps:
    """Calls a function with each kind as often as steps of a search are done, a step as long as all kinds."""

    def __init__(self, kinds: Sequence[str], tick: Callable[[str], None]) -> None:
        self._kinds, self._tick, self._part = kinds, tick, 0.0

    def done(self, share: float) -> None:
        """A share of a step is done."""
        before, self._part = self._part, self._part + share
        first, last = (math.floor(part * len(self._kinds) + 1e-9) for part in (before, self._part))
        for number in range(first, last):
            self._tick(self._kinds[number % len(self._kinds)])


def _placed(named: NamedEffect, likelihood: Likelihood, models: tuple[Model, ...]) -> NamedEffect:
    """The effect with the recordings in which it acts; its surface has the name that it has in its own model."""
    scenes = likelihood.scene.members
    own = tuple(k for k, scene in enumerate(scenes) if scene.own((named.effect,)))
    given = {t.name: s.name for k in own for s, t in zip(models[k].surfaces, scenes[k].model.surfaces, strict=True)}
    return replace(named, effect=renamed(named.effect, given), recordings=own)


def _named(likelihood: Likelihood, added: Added, verified: Verified, settings: Settings) -> tuple[NamedEffect, ...]:
    """The named effects with maps from all frames and their standard errors."""
    if verified.verdict in ("agree", "unexplained"):
        return ()
    frames, pixels = likelihood.evidence.shape
    everything = np.arange(frames), np.arange(pixels)
    errors_of = standard_errors(numbers_of(likelihood, added.state, added.chosen, fit_part(likelihood, settings)))
    state = latent_states(likelihood, added.state, everything[0])
    out = []
    for k, candidate in enumerate(added.chosen):
        effect = state.effects[k]
        if candidate.fitted is not None or k in errors_of:
            errors = errors_of.get(k, {})
        else:
            effect, errors = latent_errors(likelihood, state, effect, settings.seed)
        out.append(NamedEffect(effect=effect, stderr=errors, heldout_gain_nats=candidate.gain))
    return tuple(out)


def maps_of(effect: Effect) -> dict[str, FloatArray]:
    """The maps (row, col) of an effect by their paths in the model's folder."""
    plane = getattr(effect, "map", None)
    return {} if plane is None else {plane.path: np.asarray(plane.values, dtype=np.float64)}
