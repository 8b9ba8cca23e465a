"""The learnt noise of a layers file in numbers and in a line."""

from dataclasses import asdict, dataclass
from typing import Any

from tofmix.estimation.learnt.model import noise_words, shape_words
from tofmix.report.summary.quantiles import Quantiles, ValueCounts, spread_of
from tofmix.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseNumbers:
    """Learnt noise, or noise with parts beyond a curve. None means that the part is missing."""

    line: str  # all parts in words, as in the line of `tofmix estimate`
    # Least and largest sigma of the curve.
    sigma_least_mm: float
    sigma_most_mm: float
    shape: str  # ``Gaussian``, ``skewed (1.3)``, ``long-tailed`` or ``short-tailed``
    # Of the shape.
    skewness: float | None = None
    excess_kurtosis: float | None = None
    width_spread: float | None = None  # standard deviation of log width over the pixels
    widths: Quantiles | None = None  # the pixels' own widths, of those with a surface
    background: Quantiles | None = None  # share of background over the pixels
    # Ranges, mm, between which 90 % of the background lies, where it is not uniform over the working range.
    background_range_mm: tuple[float, float] | None = None
    # Scale of each polynomial of time that a pixel's ranges may follow within a window.
    drift_mm: list[float] | None = None
    memory: float | None = None  # correlation of the error from one frame to the next
    # Half the width of the central 68 % of a pixel's samples over sigma(r), over pixels of one layer; with the
    # recording alone.
    scatter_over_sigma: Quantiles | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the same as a dict, for JSON."""
        return asdict(self)


def has_more_than_a_curve(sensor: Sensor) -> bool:
    """Whether a sensor's noise has learnt parts, or parts of a file, beyond sigma by range and amplitude."""
    curve = sensor.noise
    if curve is None:
        return False
    return curve.has_parts or sensor.learnt is not None


def noise_numbers(sensor: Sensor, widths: ValueCounts | None = None) -> NoiseNumbers | None:
    """The numbers of a sensor's noise, with the pixels' own widths.

    None where it is a Gaussian of a curve, or there is no curve.
    """
    curve, learnt = sensor.noise, sensor.learnt
    if curve is None or not has_more_than_a_curve(sensor):
        return None
    skewness, kurtosis = (None, None) if curve.shape is None else (float(m) for m in curve.shape.moments()[2:])
    ends = None
    if curve.background_density is not None:
        near, far = (float(q) for q in curve.background_density.quantile((0.05, 0.95)))
        ends = near, far
    return NoiseNumbers(
        line=", ".join(noise_words(sensor)),
        sigma_least_mm=float(curve.sigma_mm.min()),
        sigma_most_mm=float(curve.sigma_mm.max()),
        shape=shape_words(curve),
        skewness=skewness,
        excess_kurtosis=kurtosis,
        width_spread=curve.width_spread or None,
        widths=spread_of(widths) if widths is not None and widths.count else None,
        background=None if curve.background is None else spread_of(curve.background),
        background_range_mm=ends,
        drift_mm=learnt.drift_mm.tolist() if learnt is not None and learnt.drift_mm.any() else None,
        memory=float(learnt.memory) if learnt is not None and learnt.memory else None,
    )
