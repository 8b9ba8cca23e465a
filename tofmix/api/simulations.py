"""Simulated recordings in memory, models of recorded scenes, and the reconciliation of a model with a recording."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tofmix.api.recordings import Recording
from tofmix.options import Split
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor

if TYPE_CHECKING:
    from tofmix.api.estimates import Estimate
    from tofmix.jobs.reporter import Reporter
    from tofmix.reconciliation.workflow import Reconciliation
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
        If the model is missing or wrong, the camera cannot average, or a surface leaves the bounds of a model.
    ValueError
        If `frames` or `seed` is out of its bounds.
    """
    from tofmix.jobs.simulate import Simulation

    name, scene = _model(model)
    scene = scene.with_recording(frames=frames, seed=seed)
    made = Simulation.of(scene, name, averaged=averaged, threads=os.cpu_count() or 1)
    blocks = list(made.blocks())
    stored = np.concatenate([block.range_mm for block in blocks])
    samples = ArrayRecording(
        np.where(stored > 0, stored, np.float32(np.nan)),
        made.sensor,
        np.concatenate([block.amplitude for block in blocks]),
        averaged=averaged,
    )
    return Recording(
        samples,
        made.sensor,
        shape=samples.shape,
        time_s=np.concatenate([block.time_s for block in blocks]),
        truth=made.truth,
        model_text=scene.text,
        averaged=averaged,
    )


def scene(
    source: "Recording | Estimate | str | os.PathLike[str]", *, window: int = 0, workers: int | None = None
) -> "Model":
    """Make a model of what a recording saw: each plane as a rectangle, with the camera and its noise.

    Parameters
    ----------
    source : Recording, Estimate or path
        A recording, which is estimated; layers; or the path of one of the two or of a surfaces file.
    window : int
        Number of the window of layers or surfaces. A recording is one window.
    workers : int, optional
        Threads of the estimate of a recording; all processors without it. It changes no value.

    Returns
    -------
    Model
        As `tofmix scene --planes` writes it; its `text` is the model file. If the text names a map of background
        shares, `sensor.noise.background` is the map.

    Raises
    ------
    BadInputError
        If the file cannot be read, the directions of its pixels or its noise are not known, or it shows no plane.
    UsageError
        If there is no such window.
    """
    from tofmix.api.estimates import Estimate, estimate
    from tofmix.api.recordings import PythonReporter
    from tofmix.jobs.reporter import OptionError
    from tofmix.jobs.scene import recording_settings, scene_of_file, scene_of_layers

    reporter, threads = PythonReporter(), workers or os.cpu_count() or 1
    if isinstance(source, Estimate):
        if window >= source.shape[0]:
            raise OptionError(f"window {window}: the estimate has windows 0 to {source.shape[0] - 1}")
        frames = int(source.window_stop[window] - source.window_start[window])
        settings = recording_settings(frames, None if source.recording is None else source.recording.time_s)
        name = source.provenance.source
        return scene_of_layers(source, name, reporter, window=window, recording=settings).model
    if isinstance(source, Recording):
        if window:
            raise OptionError(f"window {window}: a recording is one window here")
        settings = recording_settings(source.shape[0], source.time_s)
        layers = estimate(source, workers=threads)
        return scene_of_layers(layers, source.name, reporter, window=0, recording=settings).model
    return scene_of_file(Path(source), reporter, window=window, workers=threads).model


def reconcile(
    model: "Model | str | os.PathLike[str]",
    recording: Recording | str | os.PathLike[str],
    *,
    effects: tuple[str, ...] | None = None,
    max_effects: int = 3,
    alpha: float = 0.01,
    tolerance: float | None = None,
    split: Split = "frames,pixels",
    seed: int = 1,
    noise: Sensor | str | os.PathLike[str] | None = None,
) -> "Reconciliation":
    """Find where a simulation of a model and a recording disagree, and which effect the model lacks.

    Parameters
    ----------
    model : Model or str or path
        A model, the name of a built-in one, or a TOML file; or the file of a recording or of layers, which is the scene
        as it was seen: what is named is a change since then.
    recording : Recording or path
        The measurement.
    effects : tuple of str, optional
        Kinds of effects that are tried; all without it.
    max_effects, alpha, tolerance, split, seed
        As the options of `tofmix reconcile`.
    noise : {"model", "measured"}, path or Sensor, optional
        The model's noise, noise learnt from the recording, that of a layers file, or of a camera such as
        ``tofmix.estimate(recording, noise="auto").sensor``. The default is the model's; where this explains nothing,
        the recording's is tried too.

    Returns
    -------
    Reconciliation
        `as_dict` gives the content of gap.json; `verified.verdict` and `named` the outcome.

    Raises
    ------
    BadInputError
        If the model or the recording cannot be read, or they do not go together.
    UsageError
        If an option is out of its bounds, or `effects` names an unknown kind.

    Warns
    -----
    DoubtWarning
        If the recording and the model differ in numbers of the camera, directions of pixels or frame rate, or the model
        leaves a pattern or widths of pixels open.
    """
    from tofmix.api.recordings import PythonReporter, opened_recording
    from tofmix.jobs.estimate import learnt_sensor
    from tofmix.jobs.reconcile import check_models, kinds_of, read_evidence
    from tofmix.jobs.reconcile import reconcile as run
    from tofmix.reconciliation.settings import Settings

    def learnt() -> "Sensor":
        with measured.opened() as samples:
            return learnt_sensor(samples, reporter)

    reporter = PythonReporter()
    measured = recording if isinstance(recording, Recording) else opened_recording(Path(recording))
    name, scene = _model_or_reference(model, measured, reporter)
    settings = Settings(
        kinds=kinds_of(effects, reporter),
        max_effects=max_effects,
        alpha=alpha,
        tolerance=tolerance,
        split=split,
        seed=seed,
    )
    check_models([(name, scene)])
    with measured.opened() as samples:
        evidence = read_evidence(scene, samples, reporter, time_s=measured.time_s, temperature_c=measured.temperature_c)
    given = noise if noise is None or isinstance(noise, Sensor) else os.fspath(noise)
    return run([(scene, evidence)], settings, given, learnt, reporter)


def _model_or_reference(
    model: "Model | str | os.PathLike[str]", measured: Recording, reporter: "Reporter"
) -> tuple[str, "Model"]:
    """As `_model`; of a recording or layers the scene that they saw."""
    from tofmix.jobs.reference import check_scene_file, is_reference, longest_mm, reference_of_file

    if not isinstance(model, str | os.PathLike):
        return _model(model)
    check_scene_file(os.fspath(model))
    if not is_reference(Path(model)):
        return _model(model)
    with measured.opened() as samples:
        longest = longest_mm(samples)
    found = reference_of_file(Path(model), reporter, workers=os.cpu_count() or 1, others_mm=longest)
    return os.fspath(model), found.model


def _model(model: "Model | str | os.PathLike[str]") -> tuple[str, "Model"]:
    """The name of a model for messages, and the model."""
    from tofmix.io.model_file import load_model
    from tofmix.simulation.model import Model

    return ("model", model) if isinstance(model, Model) else (os.fspath(model), load_model(os.fspath(model)))
