"""Next steps after a verdict: one sentence each, the most useful first.

Whether the range axis folds is asked here: of two static biases that fit equally, the one of a turn is no bias.
A wall beyond the unambiguous range appears a turn nearer. A bias, a pose or a second path of metres fits such samples
as well, and the fold alone fits them badly where a pixel has a bias of several sigma. So both hypotheses are compared
with a bias of each pixel integrated out, whose spread is fitted: without the fold it is a turn, with it some mm.
"""

import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm

from tofmix.reconciliation.comparison.compare import disagreements
from tofmix.reconciliation.evidence import LEAST_PIXELS
from tofmix.reconciliation.found import Added, name_of_effect
from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.hidden_states import begin
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.pixel_pattern import biases_of_recordings, pixel_biases, with_pattern
from tofmix.reconciliation.parameters.searches import PlanePose, measured_pose, problems
from tofmix.reconciliation.settings import Settings, fit_part
from tofmix.reconciliation.verification.considered import Alias
from tofmix.reconciliation.verification.frame_levels import Jump, find_jump, frame_medians, jitter_mm
from tofmix.reconciliation.verification.missing_surface import MissingSurface, likelihood_gain, missing_surface
from tofmix.reconciliation.verification.verify import Verified, far_trends, refined_model
from tofmix.simulation.effects import EFFECTS, basic_kind
from tofmix.simulation.effects.base import Basic, Effect
from tofmix.simulation.effects.hidden import PixelBias
from tofmix.simulation.model_toml import surface_values
from tofmix.simulation.surface import Surface
from tofmix.wording import counted


def fold(likelihood: Likelihood, state: ModelState, part: Part) -> tuple[Effect, ModelState] | None:
    """The fold of the camera's phase, and the state with it, if it explains more than the state; None if not.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : ModelState
        The model with the effects added so far.
    part : (frames, pixels)
        The samples.
    """
    mixture = likelihood.mixture(state)
    if mixture.period > 0:
        return None
    for problem in problems(basic_kind(Basic.FOLD).kind, likelihood, mixture):
        effect = problem.make(np.array(problem.starts[0]))
        folded = replace(state, effects=(*state.effects, effect))
        if _with_biases(likelihood, folded, part) > _with_biases(likelihood, state, part):
            return effect, folded
    return None


def _with_biases(likelihood: Likelihood, state: ModelState, part: Part) -> float:
    """Log-likelihood of a part with a bias of each pixel integrated out, of normal spreads that are fitted."""
    mixture = likelihood.mixture(state)
    found = pixel_biases(likelihood, mixture, state, part)
    bare = likelihood.marginal(mixture, state, part).total
    pattern = hidden_fits.fit_spreads(found, likelihood.evidence.image)
    return bare if pattern is None else bare + with_pattern(found, likelihood.evidence.image, pattern[0])


_CLEAR = 5.0  # least distance from the model's pose, in standard errors
_MOSTLY = 0.8  # least share of the weighted squares of a surface's biases that another pose explains
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """What to do next.

    Parameters
    ----------
    steps : tuple of str
        Sentences, the most useful first; never empty.
    suggested : tuple of (int, Effect)
        Effects that the sentences advise to add, with their recordings, from 0.
    surfaces : tuple of (int, Surface)
        Surfaces likewise.
    """

    steps: tuple[str, ...]
    suggested: tuple[tuple[int, Effect], ...] = ()
    surfaces: tuple[tuple[int, Surface], ...] = ()


def next_steps(
    likelihood: Likelihood, added: Added, verified: Verified, unclear: Sequence[Alias], settings: Settings
) -> Advice:
    """Next steps, and the effects that they advise to add.

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
    """
    steps = [*_of_the_recording(likelihood)]
    axes = [] if verified.verdict == "agree" else list(other_axes(likelihood, settings))
    several = len(likelihood.scene.members) > 1
    steps += _of_axes(axes, several=several)
    static = Advice(steps=())
    if verified.verdict in ("unexplained", "partly_explained"):
        steps += _of_contradictions(added, verified)
        together = _together(likelihood, verified, settings)
        jumped = {number for number, each in together.items() if each.jump_mm}
        changes = [*(each.step for each in together.values()), *_of_far_trends(likelihood, verified, settings, jumped)]
        steps += changes or list(_of_few(verified))  # what changes far is told however few samples there are
        if not axes:
            static = _of_places(likelihood, added, verified, settings, together)
            steps += static.steps
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
    steps += remedies(verified)
    if verified.verdict == "explained":
        steps += worse(verified)
        steps.append(_confirming(likelihood))
    nothing = "Examine the places in `where`: no known effect explains them."
    return replace(static, steps=tuple(steps) or (nothing,))


def _of_places(
    likelihood: Likelihood,
    added: Added,
    verified: Verified,
    settings: Settings,
    together: Mapping[int, "_Together"],
) -> Advice:
    """Steps for what stays in all frames: a fold, other positions, a missing surface, the search, the lens, noise."""
    several = len(likelihood.scene.members) > 1
    steps: list[str] = []
    suggested: list[tuple[int, Effect]] = []
    named = verified.verdict == "partly_explained"  # otherwise the effects are no part of the model
    part = fit_part(likelihood, settings)
    state = verified.state if named else begin(likelihood, part[0], settings.accepted(likelihood))
    folded = fold(likelihood, state, part)
    if folded is not None:
        effect, state = folded
        suggested += [(k, effect) for k in range(len(likelihood.scene.members))]
        steps.append(
            "The samples of a surface lie a turn of the phase from the model's,"
            f" {likelihood.mixture(state).period:.5g} mm: {effect.kind} is missing."
        )
    # Poses of a model that lacks more effects than the search may add are shifted by what those do
    limited = not named and 0 < settings.max_effects <= len(added.chosen)
    jump_mm = max((each.jump_mm for each in together.values()), default=0.0)  # shifts a mean by a part of it
    offset = None if limited else common_offset(likelihood, settings, state, least_mm=jump_mm)
    poses = [] if limited or offset is not None else found_poses(likelihood, settings, state)
    poses = [f for f in poses if abs(f.pose.shift_mm) > jump_mm]
    if verified.law is not None and not poses_win(likelihood, settings, state, poses):
        poses = []
    missing = _missing(likelihood, settings, state, [offset] if offset else [pose_of(f) for f in poses])
    if missing:
        offset, poses = None, []
    if offset is not None:
        suggested += [(k, offset) for k in range(len(likelihood.scene.members))]
        steps.append(f"All surfaces are off by one value: {offset.explain()}.")
    most_poses = 3  # most poses that are listed; more are another scene
    shown = sorted(poses, key=lambda f: -f.pose.z)[:most_poses]
    steps += [*_of_missing(missing, several=several), *_of_poses(shown, several=several)]
    suggested += [(f.recording, pose_of(f)) for f in shown]
    there = {name_of_effect(e) for e in (*likelihood.scene.effects, *(state.effects if named else ()))}
    suggested = [(k, e) for k, e in suggested if name_of_effect(e) not in there]
    if suggested or missing:
        steps.append("suggested_model.toml has this: reconcile it with the same recording.")
    measured = any(scene.model.scene is not None for scene in likelihood.scene.members)
    is_known = bool(together or missing)
    steps += _of_the_search(added, verified, settings, misplaced=bool(poses), is_known=is_known, measured=measured)
    surfaces = tuple((f.recording, f.surface) for f in missing)
    return Advice(steps=tuple(steps), suggested=tuple(suggested), surfaces=surfaces)


def _confirming(likelihood: Likelihood) -> str:
    """The step after an explanation; a measured scene has no surfaces to replace by those of another scene."""
    if any(scene.model.scene is not None for scene in likelihood.scene.members):
        return "Confirm it on another recording of this scene: reconcile the written model.toml with it."
    return (
        "Confirm it on a scene that no fit has seen: reconcile the written model.toml, with the surfaces of that"
        " scene, with a recording of it."
    )


def remedies(verified: Verified) -> list[str]:
    """How a user measures or lessens the named effects, a sentence each; empty without a name."""
    named = verified.state.effects if verified.verdict in ("explained", "partly_explained") else ()
    return list(dict.fromkeys(e.remedy for e in named if e.remedy))


def worse(verified: Verified) -> Iterator[str]:
    """A statistic that the effects move away from noise alone, in a sentence; none if they move no one so.

    Parameters
    ----------
    verified : Verified
        Whose verdict is ``explained``: what stands out is within what the effects' laws may leave.
    """
    before = {c.name: c for c in verified.before.curves}
    loud = disagreements(verified.after, verified.findings.alpha)
    for curve in [c for c in loud if c.name in before and c.chi2 > before[c.name].chi2][:1]:
        yield (
            f"{curve.statistic.replace('_', ' ')} over {curve.axis} is farther from noise than without the effects"
            f" ({curve.distance:.2f} times noise alone, before {before[curve.name].distance:.2f}): no law is exact, and"
            " this is within what theirs may leave."
        )


def _of_the_recording(likelihood: Likelihood) -> Iterator[str]:
    repeated = likelihood.evidence.repeated
    own, given = likelihood.evidence.integration_time_ms, likelihood.scene.model.sensor.integration_time_ms
    same = 1e-3  # relative difference of integration times that are written in files
    if own is not None and not math.isclose(own, given, rel_tol=same):
        yield (
            f"The recording has an integration time of {own:g} ms, the model {given:g} ms: give [sensor] of the model"
            f" integration_time_ms = {own:g}, or use --noise measured."
        )
    if repeated:
        yield (
            f"{counted(repeated, 'frame')} of {repeated + likelihood.evidence.shape[0]} repeated the frame before,"
            " sample by sample, and were left out: check the driver's frame rate."
        )
    if likelihood.evidence.changed:
        yield (
            "The pixels that see the change, and those of its edge, were left out. If it is to stay, take a newer"
            " recording as the scene."
        )
    others = likelihood.evidence.others
    if others is not None:
        row, col = np.divmod(np.flatnonzero(others), likelihood.evidence.image[1])
        yield (
            f"{counted(row.size, 'pixel')} (within rows {row.min()} to {row.max()}, columns {col.min()} to {col.max()})"
            " do not follow what moves, and were left out: they see another surface for a part of the time."
        )


def _of_few(verified: Verified) -> Iterator[str]:
    found = verified.findings
    if found.few:
        worth = found.samples * found.independent
        of_them = f", worth {worth:.0f} independent ones under their memory" if found.independent < 1 else ""
        yield (
            f"Too few samples: {found.samples} were held out{of_them}, and the smallest bias that they show is"
            f" {found.smallest_sigma:.2g} sigma. Record {counted(found.missing_frames, 'more frame')}."
        )


def _of_contradictions(added: Added, verified: Verified) -> Iterator[str]:
    for against in verified.against:
        kind, surface = added.chosen[against.number].name
        of = f' of "{surface}"' if surface else ""
        yield f"{kind}{of} fits, but is no explanation: it {against.reason}."


class _Together(NamedTuple):
    """The step for a change of all pixels from a frame to the next, and the size of a jump, mm, if it is one."""

    step: str
    jump_mm: float = 0.0


def _together(likelihood: Likelihood, verified: Verified, settings: Settings) -> dict[int, _Together]:
    """The step for each recording, from 0, whose pixels change together from a frame to the next: a jump, or jitter."""
    several = len(likelihood.scene.members) > 1
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    loud = {(c.recording, c.statistic) for c in disagreements(verified.after, settings.alpha) if c.dof}
    steps = {}
    for view in views(likelihood, likelihood.mixture(verified.state), whole):
        if not loud & {(view.number, name) for name in ("common_mode", "trend")}:
            continue
        found, of = frame_medians(view), f" of recording {view.number + 1}" if several else ""
        jump = find_jump(found, view.evidence.time_s[found.frames])
        jitter = 0.0 if view.scene.model.scene is not None else jitter_mm(found, settings.alpha)
        if jump is not None:
            steps[view.number] = _Together(_of_jump(jump, view, of, several=several), abs(jump.change_mm))
        elif jitter:
            steps[view.number] = _Together(
                f"Whole frames{of} move together, by {jitter:.3g} mm from frame to frame (standard deviation), and no"
                " effect has this: the camera, its mount or the delay of its light shakes. Hold the camera still before"
                " a wall and record again: what stays is the light's."
            )
    return steps


def _of_far_trends(
    likelihood: Likelihood, verified: Verified, settings: Settings, known: Collection[int]
) -> Iterator[str]:
    """Steps for recordings that change far beside the named effects, but those for which the reason is known."""
    several = len(likelihood.scene.members) > 1
    for place in far_trends(likelihood, verified.state, settings.alpha):
        if place.recording in known:
            continue
        of = f" of recording {place.recording + 1}" if several else ""
        yield (
            f"The ranges{of} change by {place.size:+.4g} mm between {place.interval[0]:.3g} and {place.interval[1]:.3g}"
            " s: a surface or the camera moves. Reconcile frames in which nothing moves."
        )


def _of_jump(jump: Jump, view: RecordingView, of: str, *, several: bool) -> str:
    """The step for a jump; frames of the file are counted as here if none was left out."""
    at_s = view.evidence.time_s[jump.frame]
    said = f"The ranges{of} jump by {jump.change_mm:+.3g} mm at {at_s:.4g} s"
    if view.scene.model.scene is None and not view.evidence.repeated and not several:
        return f"{said}: `tofmix reconcile --self={jump.frame} MEASURED.h5 -o FOLDER` names what changed."
    return f"{said}: reconcile the frames before and after it by themselves."


def _of_the_search(
    added: Added, verified: Verified, settings: Settings, *, misplaced: bool, is_known: bool, measured: bool
) -> Iterator[str]:
    """Steps by what the search tried; `is_known`: something that no effect is explains the rest already."""
    if verified.own is not None:
        yield (
            f"The model's own {verified.own.kind} has other numbers than the camera's: correct it. The samples give:"
            f" {verified.own.explain()}."
        )
    if len(added.chosen) >= settings.max_effects and not is_known:
        number = counted(settings.max_effects, "effect")
        if verified.verdict == "partly_explained":
            yield f"The search stopped at {number}: raise --max-effects, or reconcile the written model.toml again."
        else:
            best = f"best {number} together do" if settings.max_effects > 1 else "best effect alone does"
            more = settings.max_effects + 1
            yield f"The {best} not explain it, so none is named: --max-effects {more} tries one more."
    if misplaced or is_known:  # wrong poses can also cause a smooth bias over the image, or wider noise
        return
    if verified.law == "place in the image":
        yield (
            "A smooth bias over the image fits better than any effect: suspect the lens. Give the model the camera's"
            f" own intrinsics and distortion, or measure the map of a {_kind_of_pixel_biases()} on a flat wall."
        )
    if verified.law == "range":
        yield (
            "A smooth bias in range fits better than any effect: check modulation_frequency_hz and the calibration of"
            " ranges."
        )
    noise = [c for c in verified.findings.open if c.statistic in ("spread", "spread_pattern")]
    if noise and quiet_frames_differ(verified):
        axis = f" over {noise[0].axis}" if noise[0].axis not in ("all", "frame", "time") else ""
        if measured:
            yield (
                f"The noise differs from the reference's{axis}: `tofmix estimate --noise auto` measures the curve of"
                " either recording, and `tofmix info` prints it."
            )
            return
        yield (
            f"The noise differs from the model's{axis}: try --noise measured. `tofmix estimate MEASURED.h5 --noise"
            " auto` measures its curve, and `tofmix info` prints it as a table [sensor.noise] to paste into the model."
        )


def _kind_of_pixel_biases() -> str:
    """The kind that has a bias of each pixel."""
    return next(kind.kind for kind in EFFECTS.values() if isinstance(kind.hidden, PixelBias))


def quiet_frames_differ(verified: Verified) -> bool:
    """Whether the noise of the median frame differs, not only that of some: bursts and passing things are no curve.

    The spread of a frame is that of all samples, without the part of the pixels' own biases, plus the frame's
    difference from it. Means of many samples are nearly normal, and their median has pi / 2 times the variance of a
    mean.
    """
    found = verified.findings
    for number in {c.recording for c in found.near.curves}:
        own = {(c.statistic, c.axis): c for c in found.near.curves if c.recording == number and c.dof}
        frames, whole, biases = (own.get(k) for k in (("bursts", "frame"), ("spread", "all"), ("pattern", "all")))
        if frames is None or whole is None:
            continue
        level = float(whole.value[0]) - (0.0 if biases is None else biases.size**2 / math.sqrt(2.0))
        level += float(np.median(frames.value))
        error = math.sqrt(0.5 * math.pi * float(np.median(frames.variance)) / frames.dof)
        if abs(level) > float(norm.isf(found.alpha)) * error:
            return True
    return False


def _of_poses(poses: Sequence[FoundPose], *, several: bool) -> Iterator[str]:
    for found in poses:
        where = f" of recording {found.recording + 1}" if several else ""
        side = f"{'farther' if found.farther else 'nearer'} along its normal"
        turn = math.hypot(*found.pose.tilts_deg)
        turned = f" and turned by {turn:.2g} degrees" if turn > _LEAST_TURN_DEG else ""
        yield (
            f'"{found.surface.name}"{where} is {abs(found.pose.shift_mm):.3g} mm {side}{turned}:'
            f" measure its position again, or add {effect_line(found)}"
        )


def _missing(
    likelihood: Likelihood, settings: Settings, state: ModelState, rivals: Sequence[Effect]
) -> list[MissingSurface]:
    """Surfaces that recordings show and their models lack, but where the rival effects are likelier."""
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    out = []
    for view in views(likelihood, likelihood.mixture(state), whole):
        model = refined_model(view.scene, state)
        found = missing_surface(view, model, settings)
        if found is None:
            continue
        own = view.scene.own(tuple(rivals))
        other = replace(model, effects=(*model.effects, *own))
        if not own or found.gain_nats > likelihood_gain(view, model, other, settings):
            out.append(found)
    return out


def _of_missing(missing: Sequence[MissingSurface], *, several: bool) -> Iterator[str]:
    for found in missing:
        where = f" of recording {found.recording + 1}" if several else ""
        yield (
            f"In {counted(found.pixels, 'pixel')}{where} (rows {found.rows[0]} to {found.rows[1]}, columns"
            f" {found.cols[0]} to {found.cols[1]}) {100 * found.share:.0f} % of the samples lie at about"
            f" {found.range_mm:.4g} mm, where the model has nothing: add {surface_line(found.surface)}"
        )


def surface_line(surface: Surface) -> str:
    """The table of a model file with the surface, on one line."""
    values = surface_values(surface)
    return "[[surface]] " + "; ".join(f"{k} = {json.dumps(v)}" for k, v in values.items())


def pose_of(found: FoundPose) -> Effect:
    """The effect that moves the surface to this pose; of a tilt that its angles cannot make, the shift."""
    kind, shift = basic_kind(Basic.POSE), float(f"{found.pose.shift_mm:.5g}")
    try:
        pose = kind.tilted(found.surface, shift, found.pose.tilts_deg)
    except ValueError:
        return kind.tilted(found.surface, shift)
    angles = {name: getattr(pose, name) for name, p in pose.parameters().items() if p.unit == "degree"}
    short: dict[str, Any] = {n: float(f"{v:.4g}") if abs(v) > _LEAST_TURN_DEG else 0.0 for n, v in angles.items()}
    return replace(pose, **short)


def effect_line(found: FoundPose) -> str:
    """The table of a model file that moves the surface to this pose, on one line."""
    pose = pose_of(found)
    values = {"kind": pose.kind} | {name: getattr(pose, name) for name in pose.parameters()}
    defaults = {name: p.default for name, p in pose.parameters().items()}
    return "[[effect]] " + "; ".join(f"{k} = {json.dumps(v)}" for k, v in values.items() if v != defaults.get(k, ""))


def common_offset(
    likelihood: Likelihood, settings: Settings, state: ModelState, *, least_mm: float = 0.0
) -> Effect | None:
    """The offset that explains most of the remaining biases of several surfaces; None for one surface, or else.

    By the same share of the weighted squares that a pose must explain of one surface; None up to `least_mm`.
    """
    surfaces, weight, weighed, squares = 0, 0.0, 0.0, 0.0
    for biases in biases_of_recordings(likelihood, state, fit_part(likelihood, settings)):
        for _, own in biases.surfaces:
            information, bias = biases.information[own], biases.bias_mm[own]
            surfaces += int(own.sum() >= LEAST_PIXELS)
            weight += float(information.sum())
            weighed += float((information * bias).sum())
            squares += float((information * bias**2).sum())
    several = 2  # surfaces
    if surfaces < several or weight <= 0:
        return None
    offset, explained = weighed / weight, weighed**2 / weight
    clear = abs(offset) > max(least_mm, _CLEAR / math.sqrt(weight)) and explained > _MOSTLY * squares
    return basic_kind(Basic.OFFSET).of_magnitude(float(f"{offset:.4g}")) if clear else None


def other_axes(likelihood: Likelihood, settings: Settings) -> Iterator[tuple[int, str]]:
    """Recordings, from 0, whose ranges fit the model as given along another axis, and the option that takes them so.

    A depth along z is the range times the cosine z of the unit beam. Depths that were stored as ranges have biases of
    (z - 1) r, ranges that were converted as if they were depths those of (1 / z - 1) r: without a free number, so that
    they must explain as much of all biases as a pose of one surface. An offset explains at most three quarters of such
    squares over a whole image.
    """
    state = begin(likelihood, fit_part(likelihood, settings)[0], settings.accepted(likelihood))
    for biases in biases_of_recordings(likelihood, state, fit_part(likelihood, settings)):
        own = biases.used
        if own.sum() < LEAST_PIXELS:
            continue
        mean = biases.view.mixture.of_main(biases.view.mixture.mean)[own]
        cosine, bias, information = biases.view.scene.beams[own, 2], biases.bias_mm[own], biases.information[own]
        squares = float((information * bias**2).sum())
        for option, factor in (("z", 1.0 / cosine), ("ray", cosine)):
            left = (mean + bias) * factor - mean
            explained = 1.0 - float((information * left**2).sum()) / max(squares, 1e-30)
            if explained > _MOSTLY and math.sqrt(explained * squares) > _CLEAR:
                yield biases.view.number, option


def _of_axes(axes: Sequence[tuple[int, str]], *, several: bool) -> Iterator[str]:
    for number, option in axes:
        of = f" of recording {number + 1}" if several else ""
        what = "depths along z" if option == "z" else "along the beams already, and were converted from depths along z"
        yield f"The ranges{of} fit the model if they are {what}: import the source again with --depth-axis {option}."


def poses_win(likelihood: Likelihood, settings: Settings, state: ModelState, poses: Sequence[FoundPose]) -> bool:
    """Whether the poses explain more of the biases than one smooth function of place in the image.

    Each by the squares that it leaves, with half the logarithm of the number of pixels for each of its numbers (BIC).
    """
    gain = 0.0
    numbers_of_pose = 3  # a shift and two tilts
    degree = 2  # of the smooth function of place in the image
    for biases in biases_of_recordings(likelihood, state, fit_part(likelihood, settings)):
        rows, cols = likelihood.evidence.image
        used = np.flatnonzero(biases.used)
        information, bias = biases.information[biases.used], biases.bias_mm[biases.used]
        row, col = np.divmod(used, cols)
        v, u = 2 * row / max(rows - 1, 1) - 1, 2 * col / max(cols - 1, 1) - 1
        columns = np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)
        root = np.sqrt(information)
        left = root * (bias - columns @ np.linalg.lstsq(columns * root[:, None], root * bias, rcond=None)[0])
        total, price = float((information * bias**2).sum()), math.log(max(used.size, 1))
        by_law = total - float(left @ left) - columns.shape[1] * price
        by_poses = 0.0
        names = dict(biases.surfaces)
        for found in (f for f in poses if f.recording == biases.view.number):
            weights, off = biases.information[names[found.surface.name]], biases.bias_mm[names[found.surface.name]]
            by_poses += found.pose.explained * float((weights * off**2).sum()) - numbers_of_pose * price
        gain += by_poses - by_law
    return gain > 0


def found_poses(likelihood: Likelihood, settings: Settings, state: ModelState | None = None) -> list[FoundPose]:
    """Surfaces for which another pose explains most of the remaining biases.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings and their scenes.
    state : ModelState, optional
        The model with the effects that are named; the model as given without it.
    """
    part = fit_part(likelihood, settings)
    state = state or begin(likelihood, part[0], settings.accepted(likelihood))
    out = []
    for biases in biases_of_recordings(likelihood, state, part):
        scene = biases.view.scene
        for name, own in biases.surfaces:
            if own.sum() < LEAST_PIXELS:
                continue
            surface = next(s for s in scene.model.surfaces if s.name == name)
            information, bias = biases.information[own], biases.bias_mm[own]
            pose = measured_pose(surface, scene.beams[own], bias, information)
            out.append(FoundPose(surface=surface, recording=biases.view.number, pose=pose))
    return [f for f in out if f.pose.z > _CLEAR and f.pose.explained > _MOSTLY]
