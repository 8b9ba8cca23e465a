"""Reconcile with the noise of the recording, or of another one, in place of the model's.

A model's curve is often that of a data sheet. Then every statistic of the noise disagrees, and effects are judged
with a wrong sigma. `measured_model` gives a model the noise that `tofmix.estimation` learnt; `with_fallback` chooses
between the outcomes with both.

Whether measured noise differs from the model's by a law of the camera, or by place.

A noise curve that is learnt from a recording fits that recording, also where one board is in the sun: the board has
ranges of its own, and the curve gets a step there. Use `uneven_noise` before a measured curve stands for the camera's.

The measured sigma over the model's is compared between surfaces, within surfaces, and between parts of the image. If a
camera's curve differs from the model's by range, the ratio changes with range, also within a surface. If it differs by
place, each surface has a factor of its own, and the model's curve holds within it.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.comparison.compare import LEAST_SIZE
from tofmix.reconciliation.evidence import LEAST_PIXELS, Evidence
from tofmix.reconciliation.likelihood.joint import Recording, joint_likelihood
from tofmix.reconciliation.likelihood.likelihood import ModelState
from tofmix.reconciliation.likelihood.mixture import Mixture, Scene
from tofmix.reconciliation.likelihood.side_information import log_ratios
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.verdict import LAW
from tofmix.reconciliation.workflow import DONE, Reconciliation
from tofmix.sensor import MOST_WIDTH_SPREAD, NoiseCurve, Sensor
from tofmix.simulation.effects.base import with_hidden
from tofmix.simulation.effects.hidden import RangeStep
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import with_noise

_TILES = 6  # parts of the image, along each side


@dataclass(frozen=True, slots=True, kw_only=True)
class Uneven:
    """A place with other noise than the model's curve and the rest of the scene.

    Parameters
    ----------
    place : str
        The place, in words.
    ratio, elsewhere : float
        Measured sigma over the model's, there and in the median of the other surfaces, or of the rest of the surface.
    """

    place: str
    ratio: float
    elsewhere: float

    @property
    def sentence(self) -> str:
        """The difference, and the next step."""
        return (
            f"The noise differs from the model's curve by place: {self.place} it is {self.ratio:.2f} times the model's,"
            f" elsewhere {self.elsewhere:.2f} times, and no curve of range gives that. Look for the cause there, such"
            " as sunlight or another material, and record without it; --noise measured goes on with this noise."
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ratios:
    """Log of measured sigma over the model's (pixel,), of the pixels that see a surface of one recording.

    `by` are the logarithms of what a noise curve depends on: range, and amplitude if the measured curve does.
    """

    value: FloatArray
    by: tuple[FloatArray, ...]
    surface: IntArray
    tile: IntArray
    names: tuple[str, ...]
    image: tuple[int, int]
    error: float


def uneven_noise(
    given: Sequence[Recording], measured: Sequence[Recording], state: ModelState, alpha: float
) -> Uneven | None:
    """The place whose noise differs most from the rest by no law of range or amplitude; None without one.

    Parameters
    ----------
    given, measured : sequence of (Model, Evidence)
        The recordings, with the models as given, and with the measured noise.
    state : ModelState
        Of the measured models: the effects that were found, and the pixels' own widths.
    alpha : float
        Level of the test that a part of the image differs, corrected for their number.
    """
    found = [place for ratios in _ratios(given, measured, state) for place in _places(ratios, alpha)]
    return max(found, key=_weight, default=None)


def _weight(place: Uneven) -> tuple[float, float]:
    """How much a place differs from the rest, and from the model: of two surfaces, the second decides."""
    return round(abs(math.log(place.ratio / place.elsewhere)), 2), abs(math.log(place.ratio))


def _ratios(given: Sequence[Recording], measured: Sequence[Recording], state: ModelState) -> Iterator[_Ratios]:
    bare = replace(state, log_width=np.zeros_like(state.log_width))
    own, other = joint_likelihood(given), joint_likelihood(measured)
    for number, (scene, noisy) in enumerate(zip(own.scene.members, other.scene.members, strict=True)):
        was, now = (s.mixture(s.own(bare.effects)) for s in (scene, noisy))
        lit = now.of_main(now.lit).astype(bool) & was.of_main(was.lit).astype(bool) & state.working
        ratio = np.log(now.of_main(now.sigma) / was.of_main(was.sigma)) + state.log_width[number]
        rows, cols = own.evidence.image
        row, col = np.divmod(np.flatnonzero(lit), cols)
        curve, samples = noisy.model.sensor.noise, given[number][1].samples[:, lit]
        yield _Ratios(
            value=ratio[lit],
            by=_arguments(now, lit, by_amplitude=curve.law is not None),
            surface=now.of_main(now.surface)[lit],
            tile=row * _TILES // rows * _TILES + col * _TILES // cols,
            names=tuple(s.name for s in given[number][0].surfaces),
            image=(rows, cols),
            error=math.sqrt(curve.range_mm.size / max(2 * int((samples > 0).sum()), 1)),
        )


def _arguments(mixture: Mixture, lit: BoolArray, *, by_amplitude: bool) -> tuple[FloatArray, ...]:
    values = [mixture.of_main(mixture.true_range)]
    values += [mixture.of_main(mixture.amplitude)] if by_amplitude else []
    return tuple(np.log(np.maximum(v[lit], 1e-9)) for v in values)


def _places(ratios: _Ratios, alpha: float) -> Iterator[Uneven]:
    """Surfaces with a factor of their own, and parts of the image that differ within their surface."""
    numbers = [int(k) for k in np.unique(ratios.surface) if (ratios.surface == k).sum() >= LEAST_PIXELS]
    own = {k: ratios.surface == k for k in numbers}
    factor = {k: float(ratios.value[own[k]].mean()) for k in numbers}
    limit = float(norm.isf(alpha / (2 * (len(numbers) + _TILES**2))))
    least = LEAST_SIZE + limit * ratios.error
    two = 2  # surfaces, at least, that can differ
    # Share of the change between surfaces that must be seen within them, at the same ranges: 1 for a law of range, 0
    # for a factor of each surface.
    by_range = 0.5
    if len(numbers) >= two and max(_seen_within(ratios, own, by) for by in ratios.by) < by_range:
        for k in numbers:
            others = float(np.median([factor[j] for j in numbers if j != k]))
            if abs(factor[k] - others) > least:
                yield Uneven(place=f'on "{ratios.names[k]}"', ratio=math.exp(factor[k]), elsewhere=math.exp(others))
    for k in numbers:
        yield from _tiles(ratios, own[k], (limit, least))


def _seen_within(ratios: _Ratios, own: dict[int, BoolArray], by: FloatArray) -> float:
    """Slope of the ratio's change within surfaces on the change that a law through their means has there."""
    order = sorted(own, key=lambda k: float(by[own[k]].mean()))
    at = np.array([by[own[k]].mean() for k in order])
    mean = np.array([ratios.value[own[k]].mean() for k in order])
    slopes = np.gradient(mean, at) if np.all(np.diff(at) > 0) else np.zeros(len(order))
    law = np.concatenate([slope * (by[own[k]] - x) for k, slope, x in zip(order, slopes, at, strict=True)])
    seen = np.concatenate([ratios.value[own[k]] - y for k, y in zip(order, mean, strict=True)])
    power = float(law @ law)
    return float(law @ seen) / power if power > 0 else 0.0


def _tiles(ratios: _Ratios, own: BoolArray, limits: tuple[float, float]) -> Iterator[Uneven]:
    """Parts of the image with another mean than the surface's own power law of range or amplitude leaves to them."""
    y = ratios.value[own]
    columns = np.stack([np.ones_like(y), *(by[own] for by in ratios.by)], axis=1)
    law = columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    rest, spread = y - law, LAW * float(np.std(law))
    limit, least = limits
    tile = ratios.tile[own]
    for k in np.unique(tile):
        inside = tile == k
        n = int(inside.sum())
        if n < LEAST_PIXELS or n == inside.size:
            continue
        there, elsewhere = float(rest[inside].mean()), float(np.median(rest[~inside]))
        error = float(rest[inside].std()) / math.sqrt(n)
        if abs(there - elsewhere) > limit * error + spread + least:
            yield Uneven(
                place=_words(int(k), ratios.image),
                ratio=math.exp(float(y[inside].mean())),
                elsewhere=math.exp(float(y[~inside].mean())),
            )


def _words(tile: int, image: tuple[int, int]) -> str:
    """The rows and columns of a part of the image."""
    row, col = divmod(tile, _TILES)
    limits = [(-(-k * n // _TILES), -(-(k + 1) * n // _TILES) - 1) for k, n in ((row, image[0]), (col, image[1]))]
    (top, bottom), (left, right) = limits
    return f"in rows {top} to {bottom}, columns {left} to {right},"


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
    step = next((hidden.step_mm(e) for e, hidden in with_hidden(first.effects, RangeStep)), None)
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
