"""Prediction of each pixel's next sample by a model.

Use `predict` to hold a recording against a model. The result is the marginal distribution of one sample. Links between
samples (memory, bursts of frames, neighbours) are declared by each effect and not included.
"""

import copy
from dataclasses import replace

import numpy as np

from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.distribution import Prediction
from tofmix.simulation.effects.base import Context, Level
from tofmix.simulation.model import Model
from tofmix.simulation.noise import drawn_widths
from tofmix.simulation.truth import Truth


def equation_1(truth: Truth, model: Model) -> Prediction:
    """The prediction without any effect.

    Parameters
    ----------
    truth : Truth
        Result of `tofmix.simulation.casting.cast.cast_scene` for the model.
    model : Model
        The model.

    References
    ----------
    Equation (1).
    """
    sensor = model.sensor
    pixels, layers = truth.n_modes.size, truth.range_true.shape[2]
    noise = sensor.noise_at(sensor.integration_time_ms)
    nothing, far = np.full((1, pixels), -1), np.full((1, pixels), sensor.range_max_mm)
    ranges = np.vstack([np.nan_to_num(truth.range_true.reshape(pixels, layers).T.astype(np.float64)), far])
    seen = np.nan_to_num(truth.weight_true.reshape(pixels, layers).T)
    weight = np.vstack([seen, truth.weight_no_return.reshape(1, pixels)]).astype(np.float64)
    random = sensor.random_share
    random = random if isinstance(random, float) else random.ravel()
    weight *= (1.0 - random) / weight.sum(axis=0)
    amplitude = np.vstack([truth.amplitude.reshape(pixels, layers).T.astype(np.float64), np.zeros((1, pixels))])
    return Prediction(
        turn_mm=Context(sensor=sensor, surfaces=(), seed=0).turn_mm,
        surface=np.vstack([truth.surface.reshape(pixels, layers).T.astype(np.int64), nothing]),
        true_range_mm=ranges,
        range_mm=ranges,
        amplitude=amplitude,
        sigma_mm=noise.sigma(ranges, amplitude),
        weight=weight,
        invalid=np.zeros(pixels),
        outlier=random,
        limits_mm=(sensor.range_min_mm, sensor.range_max_mm),
        stuck_mm=np.full(pixels, np.nan),
        error_shape=noise.shape,
    )


def predict(
    model: Model,
    truth: Truth | None = None,
    *,
    time_s: float = 0.0,
    seed: int | None = None,
    without_effects: Prediction | None = None,
) -> Prediction:
    """The marginal distribution of each pixel's sample at a time.

    Parameters
    ----------
    model : Model
        The model, effects included.
    truth : Truth, optional
        The scene as cast for this time; cast here if it is left out.
    time_s : float
        Time since the first frame, s.
    seed : int, optional
        Seed of the recording for the draws that hold for it all (patterns, widths); by default the model's.
    without_effects : Prediction, optional
        `equation_1` of the truth and the model, where it is known already; it stays as it is.

    Returns
    -------
    Prediction
        The mixture. Each effect's `predicts` says whether its part is exact.
    """
    if without_effects is None:
        without_effects = equation_1(cast_scene(model, time_s=time_s) if truth is None else truth, model)
    prediction = copy.copy(without_effects)  # effects put new arrays in the place of those they change
    names = tuple(surface.name for surface in model.surfaces)
    seed = model.recording.seed if seed is None else seed
    width = drawn_widths(model.sensor, seed=seed)
    if width is not None:
        prediction.sigma_mm = prediction.sigma_mm * width
    start = Context(sensor=model.sensor, surfaces=names, seed=seed, time_s=time_s)
    for effect in model.acting():
        if effect.level is not Level.GEOMETRY:
            context = replace(start, prepared=effect.prepare(start, 1))
            effect.predict(prediction, replace(context, expected=effect.expect(prediction, context)))
    return prediction
