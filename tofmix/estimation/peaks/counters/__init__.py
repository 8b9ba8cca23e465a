"""Step 1 as the paper tried it: three ways to count the surfaces of a pixel.

Adding a counter is one file and one line here. Each is a frozen dataclass of its
parameters with the paper's values as defaults; their names are the options of the
command line.
"""

from tofmix.estimation.peaks.counters.base import Counter, Peaks
from tofmix.estimation.peaks.counters.cpdf import Cpdf
from tofmix.estimation.peaks.counters.fourier import Fourier
from tofmix.estimation.peaks.counters.kde import Kde

COUNTERS: dict[str, type[Counter]] = {
    "kde": Kde,
    "cpdf": Cpdf,
    "fourier": Fourier,
}

__all__ = ["COUNTERS", "Counter", "Cpdf", "Fourier", "Kde", "Peaks"]
