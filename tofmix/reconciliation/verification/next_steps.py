"""Next steps after a verdict: one sentence each, the most useful first."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tofmix.reconciliation.likelihood.likelihood import Likelihood, State
from tofmix.reconciliation.parameters.planes import PlanePose, measured_pose
from tofmix.reconciliation.search.add import Added
from tofmix.reconciliation.search.folding import fold
from tofmix.reconciliation.search.name import Candidate
from tofmix.reconciliation.search.refit import begin
from tofmix.reconciliation.search.search_state import Settings, fit_part, name_of
from tofmix.reconciliation.search.summaries import summaries, surfaces_of
from tofmix.reconciliation.verification.aliases import Alias
from tofmix.reconciliation.verification.far_trend import far_trends
from tofmix.reconciliation.verification.verify import Verified
from tofmix.simulation.surface import Surface
from tofmix.wording import counted

_CLEAR = 5.0  # least distance from the model's pose, in standard errors
_MOSTLY = 0.8  # least share of the weighted squares of a surface's biases that another pose explains
_LEAST_PIXELS = 12  # of a surface, for a pose of three numbers
_LEAST = 1e-30  # information
_SAME = 1e-3  # relative difference of integration times that are written in files
_MOST_POSES = 3  # most poses that are listed; more are another scene
_LEAST_TURN_DEG = 0.02  # smaller tilts are not reported


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundPose:
    """The pose of a surface from its samples; recordings are numbered from 0."""

    surface: Surface
    recording: int
    pose: PlanePose

    @property
    def farther(self) -> bool:
        """Whether the surface is farther from the camera than in the model."""
        toward = float(self.surface.rotation()[:, 2] @ np.array(self.surface.center_mm))
        return self.pose.shift_mm * toward > 0


def next_steps(
    likelihood: Likelihood, added: Added, verified: Verified, unclear: Sequence[Alias], settings: Settings
) -> tuple[str, ...]:
    """Next steps, the most useful first; never empty.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings, against the models as given.
    added : Added
        The outcome of the search.
    verified : Verified
        The verdict.
    unclear : sequence of Alias
        Explanations that the recording cannot separate.
    settings : Settings
        Options of the search.
    """
    steps = [*_of_the_recording(likelihood, verified)]
    if verified.verdict in ("unexplained", "partly_explained"):
        steps += _of_contradictions(added, verified)
        steps += _of_far_trends(likelihood, verified, settings)
    if verified.verdict in ("unexplained", "partly_explained"):
        named = verified.verdict == "partly_explained"  # otherwise the effects are no part of the model
        part = fit_part(likelihood, settings)
        state = verified.state if named else begin(likelihood, part[0], settings.tolerance)
        folded = fold(likelihood, state, part)
        if folded is not None:
            state = folded.state
            steps.append(
                f"The samples of a surface lie a turn of the phase from the model's, {_turn_mm(folded):.5g} mm: add"
                f' [[effect]] kind = "{folded.kind}"; unambiguous_range_mm = {_turn_mm(folded):.8g}'
            )
        poses = found_poses(likelihood, settings, state)
        steps += _of_poses(poses, several=len(likelihood.scene.members) > 1)
        steps += _of_the_search(added, verified, settings, misplaced=bool(poses))
    for alias in unclear:
        kinds = alias.kinds
        steps.append(
            f"This recording cannot separate {kinds[0]} from {' or '.join(kinds[1:])}: record {alias.separate_by}."
        )
    if verified.verdict == "agree":
        steps.append(
            f"A bias of {verified.findings.smallest_sigma:.2g} sigma of all samples would have been seen; four times"
            " as many frames show half of that."
        )
    if verified.verdict == "explained":
        steps.append(
            "Confirm it on a scene that no fit has seen: reconcile the written model.toml, with the surfaces of that"
            " scene, with a recording of it."
        )
    return tuple(steps) or ("Examine the places in `where`: no known effect explains them.",)


def _turn_mm(folded: Candidate) -> float:
    return float(getattr(folded.effect, "unambiguous_range_mm", math.nan))


def _of_the_recording(likelihood: Likelihood, verified: Verified) -> Iterator[str]:
    repeated, found = likelihood.evidence.repeated, verified.findings
    own, given = likelihood.evidence.integration_time_ms, likelihood.scene.model.sensor.integration_time_ms
    if own is not None and not math.isclose(own, given, rel_tol=_SAME):
        yield (
            f"The recording has an integration time of {own:g} ms, the model {given:g} ms: give [sensor] of the model"
            f" integration_time_ms = {own:g}, or use --noise measured."
        )
    if repeated:
        yield (
            f"{counted(repeated, 'frame')} of {repeated + likelihood.evidence.shape[0]} repeated the frame before,"
            " sample by sample, and were left out: check the driver's frame rate."
        )
    if found.few:
        worth = found.samples * found.independent
        of_them = f", worth {worth:.0f} independent ones under their memory" if found.independent < 1 else ""
        yield (
            f"Too few samples: {found.samples} were held out{of_them}, and the smallest bias that they show is"
            f" {found.smallest_sigma:.2g} sigma. Record {counted(found.missing_frames, 'more frame')}."
        )


def _of_contradictions(added: Added, verified: Verified) -> Iterator[str]:
    for against in verified.against:
        kind, surface = name_of(added.chosen[against.number])
        of = f' of "{surface}"' if surface else ""
        yield f"{kind}{of} fits, but is no explanation: it {against.reason}."


def _of_far_trends(likelihood: Likelihood, verified: Verified, settings: Settings) -> Iterator[str]:
    several = len(likelihood.scene.members) > 1
    for place in far_trends(likelihood, verified.start, settings.alpha):
        of = f" of recording {place.recording + 1}" if several else ""
        yield (
            f"The ranges{of} change by {place.size:+.4g} mm between {place.interval[0]:.3g} and {place.interval[1]:.3g}"
            " s: a surface or the camera moves. Reconcile frames in which nothing moves."
        )


def _of_the_search(added: Added, verified: Verified, settings: Settings, *, misplaced: bool) -> Iterator[str]:
    if verified.own is not None:
        yield (
            f"The model's own {verified.own.kind} has other numbers than the camera's: correct it. The samples give:"
            f" {verified.own.explain()}."
        )
    if len(added.chosen) >= settings.max_effects:
        yield f"The search stopped at {counted(settings.max_effects, 'effect')}: raise --max-effects."
    if misplaced:  # wrong poses can also cause a bias that is smooth over the image, or wider noise
        return
    if verified.law == "place in the image":
        yield (
            "A smooth bias over the image fits better than any effect: suspect the lens. Give the model the camera's"
            " own intrinsics and distortion, or measure the map of a fixed_pattern on a flat wall."
        )
    if verified.law == "range":
        yield (
            "A smooth bias in range fits better than any effect: check modulation_frequency_hz and the calibration of"
            " ranges."
        )
    noise = [c for c in verified.findings.open if c.statistic in ("spread", "spread_pattern")]
    if noise:
        axis = f" over {noise[0].axis}" if noise[0].axis not in ("all", "frame", "time") else ""
        yield (
            f"The noise differs from the model's{axis}: measure its curve with `tofmix estimate MEASURED.h5 --noise"
            " auto` and give it to the model; by amplitude, where dark surfaces are noisier."
        )


def _of_poses(poses: Sequence[FoundPose], *, several: bool) -> Iterator[str]:
    for found in sorted(poses, key=lambda f: -f.pose.z)[:_MOST_POSES]:
        where = f" of recording {found.recording + 1}" if several else ""
        side = f"{'farther' if found.farther else 'nearer'} along its normal"
        turn = math.hypot(found.pose.yaw_deg, found.pose.pitch_deg)
        turned = f" and turned by {turn:.2g} degrees" if turn > _LEAST_TURN_DEG else ""
        yield (
            f'"{found.surface.name}"{where} is {abs(found.pose.shift_mm):.3g} mm {side}{turned}:'
            f" measure its position again, or add {effect_line(found)}"
        )


def effect_line(found: FoundPose) -> str:
    """The table of a model file that moves the surface to this pose, on one line."""
    values: dict[str, str | float] = {"surface": found.surface.name, "shift_mm": float(f"{found.pose.shift_mm:.5g}")}
    for name in ("yaw_deg", "pitch_deg"):
        if abs(getattr(found.pose, name)) > _LEAST_TURN_DEG:
            values[name] = float(f"{getattr(found.pose, name):.4g}")
    return "[[effect]] " + "; ".join(['kind = "surface_pose"', *(f"{k} = {json.dumps(v)}" for k, v in values.items())])


def found_poses(likelihood: Likelihood, settings: Settings, state: State | None = None) -> list[FoundPose]:
    """Surfaces for which another pose explains most of the remaining biases.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings and their scenes.
    settings : Settings
        How.
    state : State, optional
        The model with the effects that are named; the model as given without it.
    """
    part = fit_part(likelihood, settings)
    state = state or begin(likelihood, part[0], settings.tolerance)
    out = []
    for summary in summaries(likelihood, state, part):
        scene = summary.view.scene
        for name, own in surfaces_of(summary):
            if own.sum() < _LEAST_PIXELS:
                continue
            surface = next(s for s in scene.model.surfaces if s.name == name)
            information = summary.bias_information[:, own].sum(axis=0)
            bias = (summary.bias_information * summary.bias_mm)[:, own].sum(axis=0) / np.maximum(information, _LEAST)
            pose = measured_pose(surface, scene.beams[own], bias, information)
            out.append(FoundPose(surface=surface, recording=summary.view.number, pose=pose))
    return [f for f in out if f.pose.z > _CLEAR and f.pose.explained > _MOSTLY]
