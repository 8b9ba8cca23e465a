"""The paper's choice (section IV c): peaks of a kernel density whose bandwidth follows the noise curve.

See `tofmix.estimation.peaks.density` for equation (4) and `tofmix.estimation.peaks.modes` for test (5).
"""

from dataclasses import asdict, dataclass

import numpy as np

from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.noise.pixel_noise import beam_of_pixel
from tofmix.estimation.peaks.counters.base import Peaks, no_peaks
from tofmix.estimation.peaks.modes import find_peaks
from tofmix.estimation.samples import SortedSamples, gather, padded
from tofmix.options import KDE, check_options


@jit
def _fill(samples: SortedSamples, beam: Beam, gamma: float, epsilon: float, out: Peaks) -> None:
    frames = padded(samples.values.shape[1])
    value, count, scratch = np.empty(frames), np.empty(frames), np.empty(frames)
    for pixel in range(len(samples.valid)):
        n = samples.valid[pixel]
        if n > 0:
            own = beam_of_pixel(beam, pixel)
            out.found[pixel] = find_peaks(
                gather(samples.values[pixel], n, own.curve_range, own.curve_sigma, value, count),
                own.curve_range,
                own.curve_sigma,
                gamma,
                epsilon,
                scratch,
                out.place[pixel],
                out.height[pixel],
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Kde:
    """Kernel density with bandwidth sigma(r) / 2, equation (4), and test (5).

    Parameters
    ----------
    gamma : float
        Smallest share of the samples that makes a peak, in [0, 1): gamma of the test (5), as the
        share of the surface whose peak would just reach it.
    epsilon : float
        Largest slope at a peak, in units of p(r) / h(r), above 0: epsilon of the test (5).

    Raises
    ------
    ValueError
        If a value is out of these bounds.
    """

    gamma: float = KDE["gamma"].default
    epsilon: float = KDE["epsilon"].default

    def __post_init__(self) -> None:
        check_options(self, KDE)

    def as_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return asdict(self)

    def peaks(self, samples: SortedSamples, beam: Beam) -> Peaks:
        """Find the peaks of each pixel; see `Peaks`."""
        out = no_peaks(len(samples.valid))
        _fill(samples, beam, float(self.gamma), float(self.epsilon), out)
        return out
