"""Reconcile: compare, localise, name, add, verify; and what comes of it as a result.

Use `reconcile` on samples in memory; `tofmix.cli.reconcile` does so on files.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.reconciliation.add import Added, ways, without_faint
from tofmix.reconciliation.aliases import Alias, aliases
from tofmix.reconciliation.compare import Compared
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.joint import Recording, joint_likelihood, renamed
from tofmix.reconciliation.latent_errors import latent_errors
from tofmix.reconciliation.likelihood import Likelihood
from tofmix.reconciliation.localise import Place, localise
from tofmix.reconciliation.name import Candidate
from tofmix.reconciliation.next_steps import next_steps
from tofmix.reconciliation.own import better_own
from tofmix.reconciliation.refit import latent_states, numbers
from tofmix.reconciliation.standard_errors import standard_errors
from tofmix.reconciliation.verify import Verified, as_given, verify
from tofmix.reconciliation.way import Settings, fit_part
from tofmix.simulation.effects.base import Effect
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.effects.temporal_correlation import TemporalCorrelation
from tofmix.simulation.model import Model

DONE = ("agree", "explained")
"""Verdicts after which no other way is tried."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedEffect:
    """An effect that the measurement has and the model had not.

    Parameters
    ----------
    effect : Effect
        With its parameters; maps are named by a path beside the model.
    stderr : dict
        Standard errors of its numbers.
    heldout_gain_nats : float
        Gain on data that its fit has not seen.
    recordings : tuple of int
        In which it acts, from 0: in all of them, but for effects of a surface that some do not have.
    """

    effect: Effect
    stderr: dict[str, float]
    heldout_gain_nats: float
    recordings: tuple[int, ...] = (0,)

    @property
    def parameters(self) -> dict[str, Any]:
        """What the model file says of it."""
        values: dict[str, Any] = {}
        for name, parameter in self.effect.parameters().items():
            value = getattr(self.effect, name)
            if value is None or (value == parameter.default and name not in self.stderr):
                continue
            values[name] = value.path if isinstance(value, PixelMap) else value
            if isinstance(value, float | int):
                values[name] = float(f"{float(value):.8g}") + 0.0
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
        Where the model as given disagrees; of what is left, where effects explain a part.
    added, verified
        Search and verification.
    next_steps : tuple of str
        What to do now, the most useful first.
    """

    models: tuple[Model, ...]
    named: tuple[NamedEffect, ...]
    where: tuple[Place, ...]
    left: tuple[Place, ...]
    added: Added
    verified: Verified
    next_steps: tuple[str, ...] = ()

    @property
    def aliases(self) -> tuple[Alias, ...]:
        """What the recording cannot tell apart."""
        return aliases(self.added, named=bool(self.named))

    def acting(self, recording: int) -> tuple[NamedEffect, ...]:
        """What was found for one of the recordings, from 0."""
        return tuple(n for n in self.named if recording in n.recordings)

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Candidates of the first round, the best of each kind, best first."""
        best: dict[str, Candidate] = {}
        for candidate in self.added.first:
            best.setdefault(candidate.kind, candidate)
        return tuple(best.values())

    def as_dict(self) -> dict[str, Any]:
        """What `gap.json` holds."""
        v = self.verified
        return {
            "verdict": v.verdict,
            "effects": [self._effect(n) for n in self.acting(0)],
            **self._also(),
            "where": [_place(p) | self._in_recording(p.recording) for p in self.where],
            "left": [_place(p) | self._in_recording(p.recording) for p in self.left],
            "candidates": [
                {"kind": c.kind, "heldout_gain_nats": _short(c.gain), "parameters": c.parameters}
                for c in self.candidates
            ],
            "aliases": [_alias(group) for group in self.aliases],
            "panel": [line | self._in_recording(number) for number, line in _panel(v.before, v.after, v.floor)],
            "gap": {"before": _short(v.before.gap), "after": _short(v.after.gap), "floor": _short(v.floor.gap),
                    "closed": None if v.closed is None else _short(v.closed)},
            "next_steps": list(self.next_steps),
        }  # fmt: skip

    def _effect(self, named: NamedEffect) -> dict[str, Any]:
        said = {"kind": named.effect.kind, "parameters": named.parameters, "stderr": _rounded(named.stderr),
                "heldout_gain_nats": _short(named.heldout_gain_nats)}  # fmt: skip
        return said | ({"recordings": [k + 1 for k in named.recordings]} if len(self.models) > 1 else {})

    def _also(self) -> dict[str, Any]:
        """Effects that the first recording has not: `effects` are those of its model."""
        others = [
            {"recording": k + 1, "effects": [self._effect(n) for n in self.acting(k) if 0 not in n.recordings]}
            for k in range(1, len(self.models))
        ]
        return {"also": others} if others else {}

    def _in_recording(self, number: int) -> dict[str, Any]:
        """Which recording, from 1, where there are several."""
        return {"recording": number + 1} if len(self.models) > 1 else {}


def _alias(alias: Alias) -> dict[str, Any]:
    sets = [[{"kind": kind} | ({"surface": of} if of else {}) for kind, of in named] for named in alias.sets]
    return {"kinds": alias.kinds, "gains": [_short(g) for g in alias.gains], "separate_by": alias.separate_by,
            "effects": sets}  # fmt: skip


def _place(place: Place) -> dict[str, Any]:
    return {
        "axis": place.axis, "interval": [_short(x) for x in place.interval], "statistic": place.statistic,
        "size": _short(place.size), "unit": place.unit, "p_value": float(f"{place.p_value:.3g}"),
    }  # fmt: skip


def _panel(before: Compared, after: Compared, floor: Compared) -> list[tuple[int, dict[str, Any]]]:
    now, chance = ({c.name: c.distance for c in part.curves} for part in (after, floor))
    return [
        (c.recording, {"statistic": c.statistic, "axis": c.axis, "before": _short(c.distance),
                       "after": _short(now.get(c.name, 1.0)), "floor": _short(chance.get(c.name, 1.0))})
        for c in before.curves
    ]  # fmt: skip


def _short(value: float) -> float:
    return float(f"{value:.6g}") + 0.0  # never -0


def _rounded(values: dict[str, float]) -> dict[str, float]:
    return {name: float(f"{v:.3g}") + 0.0 for name, v in values.items()}


def reconcile(
    model: Model,
    evidence: Evidence,
    settings: Settings,
    tick: Callable[[str], None] = lambda _: None,
    *,
    also: Sequence[Recording] = (),
) -> Reconciliation:
    """Find the effects that a recording, or several of one camera, has and its model has not.

    Parameters
    ----------
    model : Model
        The model; effects that it has are kept.
    evidence : Evidence
        The recording.
    settings : Settings
        How.
    tick : callable
        Told of each kind that was tried.
    also : sequence of (Model, Evidence)
        Further recordings of the camera, which share the effects' parameters, each with the model of its scene.

    Returns
    -------
    Reconciliation
        The same for the same seed.

    Raises
    ------
    BadInputError
        If the models' cameras differ, or one has a memory and a background.
    """
    recordings = ((model, evidence), *also)
    models = tuple(model for model, _ in recordings)
    for given in models:
        _refuse_what_no_prediction_takes(given)
    likelihood = joint_likelihood(recordings)
    added, verified = _searched(likelihood, settings, tick)
    if verified.verdict != "agree":
        test = likelihood.evidence.part(fit=False, split=settings.split)
        stands = likelihood.value(added.state, test), added.chosen
        own = better_own(recordings, likelihood, stands, settings)
        if own is not None:
            verified = verify(likelihood, added, settings, own, law_stood=verified.law is not None)
    where = tuple(localise(verified.before, settings.alpha)) if verified.verdict != "agree" else ()
    left = tuple(localise(added.panel, settings.alpha)) if verified.verdict != "agree" else ()
    if verified.verdict == "partly_explained":
        where = (*left, *where)
    named = tuple(_placed(n, likelihood, models) for n in _named(likelihood, added, verified, settings))
    found = Reconciliation(models=models, named=named, where=where, left=left, added=added, verified=verified)
    return replace(found, next_steps=next_steps(likelihood, added, verified, found.aliases, settings))


def _refuse_what_no_prediction_takes(model: Model) -> None:
    """A random value has no part in a pixel's memory, and nothing in a sample says for sure that it is one.

    So scores are not normal given those of the frame before. The few of an `outlier_probability` do not show.
    """
    if model.sensor.noise.background is not None and any(e.kind == TemporalCorrelation.kind for e in model.effects):
        raise BadInputError(
            "[sensor.noise]: background: reconcile has no prediction for a background beside temporal_correlation;"
            " leave out one of them"
        )


def _searched(likelihood: Likelihood, settings: Settings, tick: Callable[[str], None]) -> tuple[Added, Verified]:
    """The first way of adding effects that explains the recording; where none does, the best verdict's first.

    Where a law that no effect is has beaten one way, no other way is tried: names only come nearer to it by chance.
    But one that has beaten a fixed pattern alone only says that there is more; and a set of effects that explains
    clearly more is tried, which must then beat the law.
    """
    if likelihood.scene.effects:  # else predictions do not approximate
        given = as_given(likelihood, settings)
        if given[1].verdict == "agree":
            return given
    tried: list[tuple[Added, Verified]] = []
    for added in ways(likelihood, settings, tick):
        stood = any(v.law is not None for _, v in tried)
        tried.append(_judged(likelihood, added, settings, law_stood=stood))
        if tried[-1][1].verdict in DONE:
            return tried[-1]
        set_is_left = len(tried) == 1 and added.sets is not None and added.sets.better(larger=True) is not None
        patterned = all(c.kind == FixedPattern.kind for c in added.chosen)
        if tried[-1][1].law is not None and not patterned and not set_is_left:
            break
    return next((way for way in tried if way[1].verdict == "partly_explained"), tried[0])


def _judged(likelihood: Likelihood, added: Added, settings: Settings, *, law_stood: bool) -> tuple[Added, Verified]:
    """A way with its verdict: as it ended, or where that is unexplained, without faint effects that explain nothing."""
    verified = verify(likelihood, added, settings, law_stood=law_stood)
    if verified.verdict != "unexplained":
        return added, verified
    less = without_faint(likelihood, settings, added, verified.findings.unsigned)
    if less is None:
        return added, verified
    without = verify(likelihood, less, settings, law_stood=law_stood)
    return (added, verified) if without.verdict == "unexplained" else (less, without)


def _placed(named: NamedEffect, likelihood: Likelihood, models: tuple[Model, ...]) -> NamedEffect:
    """In which recordings an effect acts, its surface under the name that it has in its model."""
    scenes = likelihood.scene.members
    own = tuple(k for k, scene in enumerate(scenes) if scene.own((named.effect,)))
    given = {t.name: s.name for k in own for s, t in zip(models[k].surfaces, scenes[k].model.surfaces, strict=True)}
    return replace(named, effect=renamed(named.effect, given), recordings=own)


def _named(likelihood: Likelihood, added: Added, verified: Verified, settings: Settings) -> tuple[NamedEffect, ...]:
    """The effects that stand, with maps from all frames, and their standard errors."""
    if verified.verdict in ("agree", "unexplained"):
        return ()
    frames, pixels = likelihood.evidence.shape
    everything = np.arange(frames), np.arange(pixels)
    errors_of = standard_errors(numbers(likelihood, added.state, added.chosen, fit_part(likelihood, settings)))
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
    """The maps (row, col) of an effect by their paths beside the model."""
    plane = getattr(effect, "map", None)
    return {} if plane is None else {plane.path: np.asarray(plane.values, dtype=np.float64)}
