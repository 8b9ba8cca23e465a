"""Range as a circle: a phase gives a range up to whole turns of d_u = c / (2 f).

Use it where readings are folded at the unambiguous range d_u: a surface at the
fold then reads near 0 at times and near d_u at others, and is one surface. All
functions here are for values; `tofmix.estimation.unrolling` cuts the circle open
for the estimator.
"""

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.sensor import NoiseCurve, Sensor

SPEED_OF_LIGHT_MM_S = 299_792_458_000.0  # in vacuum, mm/s; exact by the definition of the metre

NO_RETURN_SIGMAS = 2.0
"""A surface within this many sigma of `range_max_mm` is taken as no return, c_0."""

FOLD_SIGMAS = 4.0
"""Readings this many sigma past the fold may be of a surface before it."""

LEAST_SIGMAS = 10.0
"""On a shorter circle there is no room for a cut that is clear of a surface."""

TURNS = (-1, 0, 1, 2)
"""Turns of the circle that an unrolled noise curve covers: a cut range axis is within the middle two."""


def unambiguous_range_mm(modulation_frequency_hz: float) -> float:
    """Range at which the phase has turned once, d_u = c / (2 f).

    Parameters
    ----------
    modulation_frequency_hz : float
        Modulation frequency, above 0.

    Returns
    -------
    float
        d_u in mm; 7494.8 at 20 MHz.

    Raises
    ------
    ValueError
        If the frequency is not above 0.

    References
    ----------
    Lange and Seitz, IEEE J. Quantum Electronics 37(3), 2001, doi:10.1109/3.910448.
    """
    if not modulation_frequency_hz > 0:
        raise ValueError(f"modulation_frequency_hz: {modulation_frequency_hz} is not above 0")
    return SPEED_OF_LIGHT_MM_S / (2.0 * modulation_frequency_hz)


def fold(range_mm: ArrayLike, unambiguous_range_mm: float) -> FloatArray:
    """Fold ranges of any shape, mm, into [0, d_u); values that are not finite become NaN."""
    values = np.asarray(range_mm, dtype=np.float64)
    values = np.where(np.isfinite(values), values, np.nan)
    folded: FloatArray = values - unambiguous_range_mm * np.floor(values / unambiguous_range_mm)
    # A tiny negative value is rounded to d_u itself.
    return np.where(folded >= unambiguous_range_mm, 0.0, folded)


def cut_between(range_mm: ArrayLike, sigma_mm: ArrayLike, unambiguous_range_mm: float) -> float:
    """Where to cut the circle open to show surfaces: at the fold, 0, unless one of them lies across it.

    Parameters
    ----------
    range_mm, sigma_mm : (surface,) array_like
        Where the surfaces are, mm; those that are not known are left out.
    unambiguous_range_mm : float
        d_u, mm.

    Returns
    -------
    float
        0, or, if surfaces are within `FOLD_SIGMAS` of the fold, the middle of the gap that follows the last of them.
    """
    places, sigmas = fold(np.ravel(range_mm), unambiguous_range_mm), np.ravel(np.asarray(sigma_mm, dtype=np.float64))
    known = np.isfinite(places) & np.isfinite(sigmas)
    places, reach = places[known], FOLD_SIGMAS * sigmas[known]
    if not np.any((places < reach) | (places > unambiguous_range_mm - reach)):
        return 0.0
    past = places[places < reach]
    last = float(past.max() if past.size else places.max())
    ahead = fold(places - last, unambiguous_range_mm)
    gap = float(ahead[ahead > 0].min(initial=unambiguous_range_mm))
    return float(fold(last + 0.5 * gap, unambiguous_range_mm))


def open_at(range_mm: ArrayLike, cut_mm: float, unambiguous_range_mm: float) -> FloatArray:
    """Ranges of [0, d_u) on a line that begins at the cut: those before it are a turn on; any shape, mm."""
    values = np.asarray(range_mm, dtype=np.float64)
    opened: FloatArray = np.where(values < cut_mm, values + unambiguous_range_mm, values)
    return opened


def unseen_zone(sensor: Sensor, unambiguous_range_mm: float) -> float:
    """End of the unseen zone after the fold: readings in it belong to surfaces one turn farther.

    The larger of the noise curve's first range and `range_min_mm`, at most half of the circle, mm.
    """
    first = 0.0 if sensor.noise is None else float(sensor.noise.range_mm[0])
    return min(max(first, sensor.range_min_mm or 0.0, 0.0), 0.5 * unambiguous_range_mm)


def circular_noise(sensor: Sensor, unambiguous_range_mm: float, *, at_fold: bool = True) -> NoiseCurve:
    """sigma(r) on the circle, unrolled over `TURNS`.

    The file's curve on most of the circle. Right after the fold it is not known whether a reading is of a near
    surface or of one a turn farther away, which is certain where the camera sees nothing so near (`unseen_zone`):
    sigma stays sigma(d_u) over half of that, and goes linearly to sigma at the far end of the zone, so that a
    surface at the fold has one sigma on both sides. The zone ends at the largest of the curve's first range,
    `range_min_mm` and 4 sigma(d_u), and takes at most half of the circle. Without `at_fold`, for pixels with
    nothing at the fold, 4 sigma(d_u) do not count.

    Parameters
    ----------
    sensor : Sensor
        Noise curve and `range_min_mm`.
    unambiguous_range_mm : float
        d_u, mm.
    at_fold : bool
        Whether a surface may lie at the fold.

    Returns
    -------
    NoiseCurve
        From -d_u to 3 d_u; it repeats from turn to turn.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, or the circle is shorter than `LEAST_SIGMAS` sigma.
    """
    curve, length = sensor.noise, float(unambiguous_range_mm)
    if curve is None:
        raise ValueError("the sensor has no noise curve sigma(r)")
    top = float(curve.sigma(length))
    unseen = zone = unseen_zone(sensor, length)
    if at_fold:
        zone = min(max(zone, FOLD_SIGMAS * top), 0.5 * length)
    level = [0.5 * unseen] if unseen > 0 else []
    inner = curve.range_mm[(curve.range_mm > zone) & (curve.range_mm < length)]
    range_mm = np.concatenate([[0.0], level, [zone] if zone > 0 else [], inner])
    sigma_mm = np.concatenate([np.full(1 + len(level), top), curve.sigma(range_mm[1 + len(level) :])])
    least = LEAST_SIGMAS * float(sigma_mm.max())
    if not length >= least:
        raise ValueError(f"an unambiguous range of {length:g} mm is shorter than {LEAST_SIGMAS:g} sigma, {least:g} mm")
    knots = np.concatenate([range_mm + turn * length for turn in TURNS] + [[(TURNS[-1] + 1) * length]])
    return NoiseCurve(knots, np.append(np.tile(sigma_mm, len(TURNS)), top))


def has_no_return(sensor: Sensor, unambiguous_range_mm: float) -> bool:
    """Whether c_0 can be separated on the circle: `range_max_mm` + 2 sigma lies before the fold."""
    if sensor.range_max_mm is None or sensor.noise is None:
        return False
    reach = NO_RETURN_SIGMAS * float(sensor.noise.sigma(sensor.range_max_mm))
    return sensor.range_max_mm + reach <= unambiguous_range_mm
