"""Simulated recordings in memory, and the reconciliation of a model with a recording."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tofmix.api.recordings import Recording
from tofmix.choices import Split
from tofmix.errors import BadInputError
from tofmix.recording import ArrayRecording

if TYPE_CHECKING:
    from tofmix.reconciliation.workflow import Reconciliation
    from tofmix.sensor import Sensor
    from tofmix.simulation.model import Model


def simulate(
    model: "Model | str | os.PathLike[str]",
    *,
    frames: int | None = None,
    seed: int | None = None,
    averaged: bool = False,
) -> Recording:
    """Simulate a recording of a model.

    Parameters
    ----------
    model : Model or str or path
        A model, the name of a built-in one, or a TOML file.
    frames, seed : int, optional
        Number of frames, and seed of every draw; the model's without them.
    averaged : bool
        Whether the frames are the camera's on-board averages.

    Returns
    -------
    Recording
        In memory, with its truth; the samples are those that `tofmix simulate` writes.

    Raises
    ------
    BadInputError
        If the model is missing or wrong, or the camera cannot average.
    """
    from tofmix.simulation.casting.cast import cast_scene
    from tofmix.simulation.render import recording_sensor, render_blocks

    scene = _model(model)
    sensor, truth = recording_sensor(scene, averaged=averaged), cast_scene(scene)
    n_frames = scene.recording.frames if frames is None else frames
    blocks = list(
        render_blocks(
            scene, truth, n_frames=n_frames, seed=scene.recording.seed if seed is None else seed, averaged=averaged,
            threads=os.cpu_count() or 1,
        )
    )  # fmt: skip
    stored = np.concatenate([block.range_mm for block in blocks])
    samples = ArrayRecording(
        np.where(stored > 0, stored, np.float32(np.nan)), sensor,
        np.concatenate([block.amplitude for block in blocks]), averaged=averaged,
    )  # fmt: skip
    return Recording(
        samples, sensor, shape=samples.shape, time_s=np.concatenate([block.time_s for block in blocks]), truth=truth,
        model_text=scene.text, averaged=averaged,
    )  # fmt: skip


def reconcile(
    model: "Model | str | os.PathLike[str]",
    recording: Recording | str | os.PathLike[str],
    *,
    effects: tuple[str, ...] | None = None,
    max_effects: int = 3,
    alpha: float = 0.01,
    tolerance: float = 0.1,
    split: Split = "frames,pixels",
    seed: int = 1,
    noise: "Sensor | None" = None,
) -> "Reconciliation":
    """Find where a simulation of a model and a recording disagree, and which effect the model lacks.

    Parameters
    ----------
    model : Model or str or path
        A model, the name of a built-in one, or a TOML file.
    recording : Recording or path
        The measurement.
    effects : tuple of str, optional
        Kinds of effects that are tried; all without it.
    max_effects, alpha, tolerance, split, seed
        As the options of `tofmix reconcile`.
    noise : Sensor, optional
        A camera whose noise replaces the model's, such as ``tofmix.estimate(recording, noise="auto").sensor``.

    Returns
    -------
    Reconciliation
        `as_dict` gives the content of gap.json; `verified.verdict` and `named` the outcome.

    Raises
    ------
    BadInputError
        If the model or the recording cannot be read, or they do not go together.
    UsageError
        If an option is out of its bounds.
    ValueError
        If `effects` names an unknown kind.
    """
    from tofmix.api.recordings import opened_recording
    from tofmix.reconciliation.evidence import make_evidence
    from tofmix.reconciliation.search.name import KINDS
    from tofmix.reconciliation.search.search_state import Settings
    from tofmix.reconciliation.workflow import reconcile as run

    scene = _model(model)
    measured = recording if isinstance(recording, Recording) else opened_recording(Path(recording))
    unknown = [kind for kind in effects or () if kind not in KINDS]
    if unknown:
        raise ValueError(f"effects: {unknown[0]!r} is not one of {', '.join(KINDS)}")
    if not scene.surfaces:
        raise BadInputError("model: it has no surface to compare the recording with")
    settings = Settings(
        kinds=tuple(kind for kind in KINDS if effects is None or kind in effects), max_effects=max_effects,
        alpha=alpha, tolerance=tolerance, split=split, seed=seed,
    )  # fmt: skip
    evidence = make_evidence(
        scene, measured.range_mm, time_s=measured.time_s, amplitude=measured.amplitude,
        temperature_c=measured.temperature_c, integration_time_ms=measured.sensor.integration_time_ms,
    )  # fmt: skip
    if noise is None:
        return run(scene, evidence, settings)
    from tofmix.reconciliation.measured_noise import measured_model, with_note

    other = measured_model(scene, evidence, noise)
    return with_note((run(other, evidence, settings), [(other, evidence)]), [(scene, evidence)], settings)


def _model(model: "Model | str | os.PathLike[str]") -> "Model":
    from tofmix.io.model_file import load_model
    from tofmix.simulation.model import Model

    return model if isinstance(model, Model) else load_model(os.fspath(model))
