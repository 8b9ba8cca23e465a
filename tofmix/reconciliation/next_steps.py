"""What to do after a verdict: one sentence each, the most useful first."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.projection import beam_directions_of
from tofmix.reconciliation.add import Added
from tofmix.reconciliation.aliases import Alias
from tofmix.reconciliation.likelihood import Likelihood
from tofmix.reconciliation.refit import begin
from tofmix.reconciliation.summaries import Summary, summaries, surfaces_of
from tofmix.reconciliation.verdict import SIGMAS
from tofmix.reconciliation.verify import Verified
from tofmix.reconciliation.way import Settings, fit_part
from tofmix.simulation.model import Surface
from tofmix.wording import counted

_CLEAR = 5.0  # standard errors by which a surface stands elsewhere
_MOSTLY = 0.8  # of the weighted squares of a surface's biases, that another pose must explain
_LEAST_PIXELS = 12
_PASSES, _FAR = 3, 6.0  # of the fit of a plane; medians of what is left, beyond which a pixel is left out
_MOST_POSES = 3
_LEAST_TURN_DEG = 0.02  # a smaller tilt is not worth a word


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundPose:
    """Where the samples put a surface.

    Parameters
    ----------
    surface : str
        Its name.
    recording : int
        In which recording, from 0.
    shift_mm : float
        Along the model's normal, mm.
    farther : bool
        Whether that is away from the camera.
    yaw_deg, pitch_deg : float
        Turn beyond the model's, degrees.
    explained : float
        Share of the weighted squares of its biases that this explains.
    z : float
        How far it is from the model's pose, in standard errors.
    """

    surface: str
    recording: int
    shift_mm: float
    farther: bool
    yaw_deg: float
    pitch_deg: float
    explained: float
    z: float


def next_steps(
    likelihood: Likelihood, added: Added, verified: Verified, unclear: Sequence[Alias], settings: Settings
) -> tuple[str, ...]:
    """What to do, the most useful first; never empty.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings, against the models as given.
    added : Added
        The outcome of the search.
    verified : Verified
        The verdict.
    unclear : sequence of Alias
        What is not told apart.
    settings : Settings
        How it was looked for.
    """
    steps = [*_of_the_recording(likelihood, verified)]
    if verified.verdict in ("unexplained", "partly_explained"):
        steps += _of_poses(likelihood, settings)
        steps += _of_the_search(added, verified, settings)
    for alias in unclear:
        kinds = alias.kinds
        steps.append(
            f"{kinds[0]} and {' or '.join(kinds[1:])} are not told apart by this recording: record {alias.separate_by}."
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
    return tuple(steps) or (
        "Look at the places in `where`: what the camera does there is none of the effects that are known.",
    )


def _of_the_recording(likelihood: Likelihood, verified: Verified) -> Iterator[str]:
    repeated, found = likelihood.evidence.repeated, verified.findings
    if repeated:
        yield (
            f"{counted(repeated, 'frame')} of {repeated + likelihood.evidence.shape[0]} repeated the frame before,"
            " sample by sample, and were left out: check the driver's frame rate."
        )
    if found.few:
        frames = math.ceil(likelihood.evidence.shape[0] * (found.smallest_sigma / SIGMAS) ** 2)
        yield (
            f"Too few samples: {found.samples} were held out, and the smallest bias that they show is"
            f" {found.smallest_sigma:.2g} sigma. Record {frames} frames or more, or more pixels."
        )


def _of_the_search(added: Added, verified: Verified, settings: Settings) -> Iterator[str]:
    if verified.own is not None:
        yield (
            f"The model's own {verified.own.kind} has other numbers than the camera's: correct it. By the samples,"
            f" {verified.own.explain()}."
        )
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
    if len(added.chosen) >= settings.max_effects:
        yield f"The search stopped at {counted(settings.max_effects, 'effect')}: raise --max-effects."
    noise = [c for c in verified.findings.open if c.statistic in ("spread", "spread_pattern")]
    if noise:
        axis = f" over {noise[0].axis}" if noise[0].axis not in ("all", "frame", "time") else ""
        yield (
            f"The noise differs from the model's{axis}: measure its curve with `tofmix estimate MEASURED.h5 --noise"
            " auto` and give it to the model; by amplitude, where dark surfaces are noisier."
        )


def _of_poses(likelihood: Likelihood, settings: Settings) -> Iterator[str]:
    poses = found_poses(likelihood, settings)
    several = len(likelihood.scene.members) > 1
    for pose in sorted(poses, key=lambda p: -p.z)[:_MOST_POSES]:
        where = f" of recording {pose.recording + 1}" if several else ""
        way = f"{'farther' if pose.farther else 'nearer'} along its normal"
        turn = math.hypot(pose.yaw_deg, pose.pitch_deg)
        turned = f" and turned by {turn:.2g} degrees" if turn > _LEAST_TURN_DEG else ""
        yield (
            f'"{pose.surface}"{where} is {abs(pose.shift_mm):.3g} mm {way}{turned}: measure its place again, or add'
            f" {effect_line(pose)}"
        )


def effect_line(pose: FoundPose) -> str:
    """The table of a model file that moves the surface there, on one line of text."""
    values = {"surface": pose.surface, "shift_mm": float(f"{pose.shift_mm:.5g}")}
    for name in ("yaw_deg", "pitch_deg"):
        if abs(getattr(pose, name)) > _LEAST_TURN_DEG:
            values[name] = float(f"{getattr(pose, name):.4g}")
    return "[[effect]] " + "; ".join(['kind = "surface_pose"', *(f"{k} = {json.dumps(v)}" for k, v in values.items())])


def found_poses(likelihood: Likelihood, settings: Settings) -> list[FoundPose]:
    """Surfaces of which another pose explains most of what their samples are off by."""
    start = begin(likelihood, fit_part(likelihood, settings)[0], settings.tolerance)
    out = []
    for summary in summaries(likelihood, start, fit_part(likelihood, settings)):
        sensor = summary.view.scene.model.sensor
        beams = beam_directions_of(sensor.optics, sensor.shape).reshape(-1, 3)
        for name, own in surfaces_of(summary):
            surface = next(s for s in summary.view.scene.model.surfaces if s.name == name)
            if own.sum() >= _LEAST_PIXELS:
                out.append(_pose(summary, surface, own, beams))
    tolerance = settings.tolerance
    return [p for p in out if p.z > _CLEAR and p.explained > _MOSTLY and abs(p.shift_mm) > tolerance]


def _pose(summary: Summary, surface: Surface, own: BoolArray, beams: FloatArray) -> FoundPose:
    """A plane through a surface's pixels, each at its measured mean.

    A beam d meets the plane q . p = 1 at the range 1 / (q . d), so that the inverse range is linear in q.
    """
    m = summary.view.mixture
    information = summary.bias_information[:, own].sum(axis=0)
    bias = (summary.bias_information * summary.bias_mm)[:, own].sum(axis=0) / np.maximum(information, 1e-30)
    expected = m.of_main(m.mean)[own]
    measured = np.maximum(expected + bias, 1.0)
    d = beams[own]
    root = np.sqrt(information) * measured**2  # the error of 1 / r is that of r over r squared
    use = np.ones(bias.size, dtype=bool)
    for _ in range(_PASSES):  # where an edge has moved, a pixel sees another surface
        change, *_ = np.linalg.lstsq((d * root[:, None])[use], ((1 / measured - 1 / expected) * root)[use], rcond=None)
        left = (1 / measured - 1 / expected - d @ change) * root
        use = np.abs(left) <= _FAR * max(float(np.median(np.abs(left))), 1.0)
    curvature = (d * root[:, None])[use].T @ (d * root[:, None])[use]
    total = float((information * bias**2)[use].sum())
    normal = surface.rotation()[:, 2]
    center = np.array(surface.center_mm)
    before = normal / float(normal @ center)
    after = before + change
    new = after / np.linalg.norm(after) * math.copysign(1.0, float(after @ normal))
    distance = 1.0 / float(after @ normal) if float(after @ normal) else math.inf
    shift = distance * (1.0 - float(after @ center))
    yaw = math.degrees(math.asin(float(np.clip(new[0], -1, 1)))) - surface.yaw_deg
    pitch = math.degrees(math.atan2(-float(new[1]), float(new[2]))) - surface.pitch_deg
    return FoundPose(
        surface=surface.name, recording=summary.view.number, shift_mm=shift,
        farther=bool(shift * float(normal @ center) > 0), yaw_deg=yaw, pitch_deg=pitch,
        explained=1.0 - float((left[use] ** 2).sum()) / max(total, 1e-30),
        z=math.sqrt(max(float(change @ curvature @ change), 0.0)),
    )  # fmt: skip
