"""Reconcile with the noise of the recording, or of another one, in place of the model's.

A model's curve is often that of a data sheet. Then every statistic of the noise disagrees, and effects are judged
with a wrong sigma. `measured_model` gives a model the noise that `tofmix.estimation` learnt; `with_fallback` chooses
between the outcomes with both.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import Recording
from tofmix.reconciliation.likelihood.mixture import Mixture, Scene
from tofmix.reconciliation.likelihood.side_information import log_ratios
from tofmix.reconciliation.noise_by_place import uneven_noise
from tofmix.reconciliation.search.search_state import Settings
from tofmix.reconciliation.workflow import DONE, Reconciliation
from tofmix.sensor import MOST_WIDTH_SPREAD, NoiseCurve, Sensor
from tofmix.simulation.effects.quantisation import Quantisation
from tofmix.simulation.model import Model
from tofmix.simulation.model_noise import with_noise

MODEL, MEASURED = "model", "measured"
"""Noise of the model file, and noise that is learnt from the recording."""

Recordings = Sequence[Recording]
Outcome = tuple[Reconciliation, Recordings]
"""What was found, and the models and recordings in which."""

_BEST_FIRST = ("agree", "explained", "partly_explained", "unexplained")


def measured_model(model: Model, evidence: Evidence, sensor: Sensor) -> Model:
    """The model with the noise of a sensor: sigma by range and amplitude, shape, widths, background and step.

    Amplitudes of a recording may have any unit: the curve's are put into the model's by the median ratio of recorded
    and predicted ones. Where a pixel's own amplitude differs from the predicted one, its noise does too; this widens
    the spread of the pixels' own widths, which `reconcile` fits.

    Parameters
    ----------
    model : Model
        The model.
    evidence : Evidence
        The recording that it is compared with, for its amplitudes.
    sensor : Sensor
        With a noise curve.

    Raises
    ------
    ValueError
        If the sensor has no noise curve.
    BadInputError
        If the model's file has its noise in a form that cannot be replaced.
    """
    curve = sensor.noise
    if curve is None:
        raise ValueError("the sensor has no noise curve")
    if curve.law is not None:
        curve = _in_units_of(model, evidence, curve)
    background = curve.background
    if background is not None and background.ndim and background.shape != model.sensor.shape:
        curve = replace(curve, background=np.array(float(background.mean())))
    step = sensor.range_step_mm
    return with_noise(model, curve, step_mm=float(step) if step is not None and np.ndim(step) == 0 else None)


def _in_units_of(model: Model, evidence: Evidence, curve: NoiseCurve) -> NoiseCurve:
    """The curve with amplitudes in the model's unit, and with the widths that amplitudes leave to each pixel."""
    law, mixture = curve.law, Scene(model, evidence.time_s).mixture()
    ratios = list(log_ratios(model, evidence, mixture).values())
    if law is None or not ratios:
        return replace(curve, law=None)
    unit = float(np.exp(np.median(ratios)))
    curve = replace(curve, law=replace(law, reference=law.reference / unit, amplitude=law.amplitude / unit))
    spread = float(np.hypot(curve.width_spread, _unpredicted(curve, evidence, mixture, unit)))
    return replace(curve, width_spread=min(spread, MOST_WIDTH_SPREAD))


def _unpredicted(curve: NoiseCurve, evidence: Evidence, mixture: Mixture, unit: float) -> float:
    """Standard deviation of the logarithm of sigma at the recorded amplitudes over sigma at the predicted ones."""
    predicted, ranges = mixture.of_main(mixture.amplitude), mixture.of_main(mixture.true_range)
    recorded = evidence.amplitude
    if recorded is None:
        return 0.0
    use = mixture.of_main(mixture.lit).astype(bool) & (recorded > 0) & (predicted > 0)
    if not use.any():
        return 0.0
    ratio = np.log(curve.sigma(ranges[use], recorded[use] / unit) / curve.sigma(ranges[use], predicted[use]))
    return float(ratio.std())


def measured_models(recordings: Sequence[tuple[Model, Evidence]], sensor: Sensor) -> list[tuple[Model, Evidence]]:
    """The models of several recordings of one camera with the same noise, in units of the first one's amplitudes.

    Parameters and errors as of `measured_model`.
    """
    first = measured_model(*recordings[0], sensor)
    step = next((e.step_mm for e in first.effects if isinstance(e, Quantisation)), None)
    others = [(with_noise(model, first.sensor.noise, step_mm=step), evidence) for model, evidence in recordings[1:]]
    return [(first, recordings[0][1]), *others]


def is_open(found: Reconciliation) -> bool:
    """Whether the outcome leaves something unexplained, which a wrong noise may have caused."""
    return found.verified.verdict not in DONE


def with_fallback(given: Outcome, measured: Outcome, settings: Settings) -> Reconciliation:
    """The better of the outcomes with the model's own noise and with the measured one.

    A curve that is learnt from a recording fits it, also where the noise differs by place. Then no curve of the camera
    is known, and the outcome with the model's own noise stays, with a sentence that names the place.

    Parameters
    ----------
    given, measured : (Reconciliation, sequence of (Model, Evidence))
        The outcomes, each with its recordings.
    settings : Settings
        Options of the search.
    """
    rank = {verdict: place for place, verdict in enumerate(_BEST_FIRST)}
    if rank[measured[0].verified.verdict] >= rank[given[0].verified.verdict]:
        return given[0]
    place = uneven_noise(given[1], measured[1], measured[0].verified.state, settings.alpha)
    if place is None:
        return with_note(measured, given[1], settings)
    return replace(given[0], next_steps=(place.sentence, *given[0].next_steps))


def with_note(measured: Outcome, given: Recordings, settings: Settings) -> Reconciliation:
    """The outcome with its measured noise before the next steps: by how much it differs, and at which place.

    Parameters
    ----------
    measured : (Reconciliation, sequence of (Model, Evidence))
        The outcome with the measured noise, and its recordings.
    given : sequence of (Model, Evidence)
        The recordings with the models as given.
    settings : Settings
        Options of the search.
    """
    found, recordings = measured
    place = uneven_noise(given, recordings, found.verified.state, settings.alpha)
    steps = [noise_sentence(given[0][0], found.models[0]), *([] if place is None else [place.sentence])]
    return replace(found, measured_noise=True, next_steps=(*steps, *found.next_steps))


def noise_sentence(given: Model, measured: Model) -> str:
    """By how much the measured noise of a model differs from its own, in one sentence."""
    curve, own = measured.sensor.noise, given.sensor.noise_at(given.sensor.integration_time_ms)
    ratio = curve.sigma_mm / own.sigma(curve.range_mm)
    low, high = float(ratio.min()), float(ratio.max())
    times = f"{low:.2f}" if high - low < 0.005 * high else f"{low:.2f} to {high:.2f}"
    parts = ["a shape of its own"] if curve.shape is not None else []
    parts += [f"widths of pixels spread by {100 * curve.width_spread:.0f} %"] if curve.width_spread else []
    more = f", and {' and '.join(parts)}" if parts else ""
    return (
        f"The noise differs from the model's curve: the measured sigma is {times} times the model's{more}."
        " [sensor.noise] of model.toml has it: give it to your model."
    )
