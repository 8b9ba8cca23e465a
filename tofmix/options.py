"""Options that commands and Python functions share, each declared once: default, bounds, choices and help.

A command makes its options from these rows, and a class of settings takes its defaults and its checks from them. The
names of choices are types too: for a type checker, ``sigma="tide"`` is an error before it runs. The module imports
nothing that a command's ``--help`` would wait for.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Literal, get_args

Sigma = Literal["tied", "prior", "free"]
Refine = Literal["likelihood", "none"]
Mixing = Literal["auto", "events", "phasor"]
Shape = Literal["gaussian", "auto"]
Widths = Literal["common", "own", "auto"]
Units = Literal["mm", "cm", "m"]
DepthAxis = Literal["ray", "z"]
Split = Literal["frames,pixels", "frames", "pixels"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """One option.

    Parameters
    ----------
    help : str
        The option in a sentence.
    default : int, float, str, bool or None
        Its value where none is given; None where the option has no value then.
    whole : bool
        Whether its values are whole numbers.
    low, high : float
        Bounds of numbers; infinite ones are no values.
    low_open, high_open : bool
        Whether the bound itself is refused.
    choices : tuple of str
        Its values, if they are words.
    """

    help: str
    default: Any = None
    whole: bool = False
    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False
    choices: tuple[str, ...] = ()

    @property
    def is_flag(self) -> bool:
        """Whether it is on or off."""
        return isinstance(self.default, bool)

    @property
    def bounds(self) -> str:
        """The numbers that it may have, such as ``1 to 32``, ``above 0`` or ``in [0, 1)``."""
        if math.isinf(self.high):
            return f"{'above' if self.low_open else 'at least'} {self.low:g}"
        if not (self.low_open or self.high_open):
            return f"{self.low:g} to {self.high:g}"
        return f"in {'(' if self.low_open else '['}{self.low:g}, {self.high:g}{')' if self.high_open else ']'}"

    def refusal(self, name: str, value: Any) -> str:  # noqa: ANN401  any value that a caller gives
        """Why a value is refused; empty if it is not."""
        if value is None and self.default is None:
            return ""
        if self.is_flag:
            return "" if isinstance(value, bool) else f"{name}: {value!r} is neither True nor False"
        if self.choices:
            return "" if value in self.choices else f"{name}: {value!r} is not one of {', '.join(self.choices)}"
        if not isinstance(value, Integral if self.whole else Real) or isinstance(value, bool):
            return f"{name}: {value!r} is not a {'whole number' if self.whole else 'number'}"
        number = float(value)
        below = number <= self.low if self.low_open else number < self.low
        above = number >= self.high if self.high_open or math.isinf(self.high) else number > self.high
        return f"{name}: {value} is not {self.bounds}" if below or above or math.isnan(number) else ""


def check_options(settings: Any, options: Mapping[str, Option]) -> None:  # noqa: ANN401  of any class
    """Refuse settings with a value that an option of the same name may not have.

    Raises
    ------
    ValueError
        The message begins with the name.
    """
    for name, option in options.items():
        if refusal := option.refusal(name, getattr(settings, name)):
            raise ValueError(refusal)


MAX_LAYERS_LIMIT = 32
"""Layers of a pixel that a layers file may hold."""

KDE = {
    "gamma": Option(
        default=0.02, low=0, high=1, high_open=True, help="Smallest share of the samples in a peak of the density."
    ),
    "epsilon": Option(default=0.01, low=0, low_open=True, help="Largest slope at a peak, in units of p(r) / h(r)."),
}
CPDF = {
    "bins": Option(
        default=15, whole=True, low=2, high=100, help="Bins of the cumulative distribution over the working range."
    ),
    # A wider step than the largest ratio joins all surfaces of a working range
    "ratio": Option(default=1.1, low=1, high=10, low_open=True, help="k of F(r) = P(k r) - P(r)."),
}
FOURIER = {
    "order": Option(default=16, whole=True, low=1, high=64, help="Last term of the series."),
    "level": Option(
        default=0.1, low=0, high=1, high_open=True, help="Smallest share of the samples in a peak of the series."
    ),
}
COUNTERS = {"kde": KDE, "cpdf": CPDF, "fourier": FOURIER}
"""The counters of `tofmix.estimation.peaks.counters` with their options."""

ESTIMATE = {
    "sigma": Option(
        default="prior",
        choices=get_args(Sigma),
        help="Sigma of a surface. tied: the noise curve. prior: pulled towards the curve. free: fitted, as in the"
        " paper.",
    ),
    "max_layers": Option(default=6, whole=True, low=1, high=MAX_LAYERS_LIMIT, help="Most surfaces in a pixel."),
    "refine": Option(
        default="likelihood",
        choices=get_args(Refine),
        help="likelihood: count surfaces by likelihood, from the peaks on. none: count the peaks, as in the paper.",
    ),
    "false_alarm": Option(
        default=1.0e-3,
        low=1.0e-6,
        high=0.1,
        help="Probability that a pixel with one surface gets more than one; with --refine likelihood.",
    ),
    "max_iter": Option(default=50, whole=True, low=1, high=2**16 - 1, help="Most EM iterations."),
    "tol": Option(
        default=1.0e-3,
        low=0,
        high=1,
        low_open=True,
        high_open=True,
        help="EM stops when each mean moves by less than this many sigma, and each share by less than this.",
    ),
    # No layer rests on a single sample
    "min_samples": Option(default=3, whole=True, low=2, help="Fewest valid samples of a fitted pixel."),
    "unambiguous_range_mm": Option(
        low=0,
        low_open=True,
        help="Unambiguous range, mm. Ranges fold at this length; a surface at the fold counts once.",
    ),
    "mixing": Option(
        default="auto",
        choices=get_args(Mixing),
        help="How surfaces mix in a sample. events: each sample shows one surface. phasor: light adds up, and"
        " neighbours help to unmix it. auto: measure.",
    ),
    "paper": Option(default=False, help="Use the paper's own algorithm, for comparison; --gamma is its threshold."),
}
"""Options of `tofmix.estimation.settings.EstimateOptions`, but for the counter."""

NOISE = {
    "noise_shape": Option(
        default="auto",
        choices=get_args(Shape),
        help="Shape of the error in measured noise: Gaussian, or learnt from the samples.",
    ),
    "noise_widths": Option(
        default="auto",
        choices=get_args(Widths),
        help="Width of measured noise: one of all pixels (common), of each pixel (own), or as the samples show (auto).",
    ),
}
"""Options of measured noise."""

RECONCILE = {
    "seed": Option(default=1, whole=True, low=0, help="Seed of every random draw."),
    "max_effects": Option(default=3, whole=True, low=0, high=10, help="Most effects to add."),
    "alpha": Option(
        default=0.01,
        low=0,
        high=0.5,
        low_open=True,
        help="Significance level of the tests, corrected for their number.",
    ),
    "tolerance": Option(
        low=0,
        high=1,
        help="Accepted model error: pose errors up to this many sigma, and sigma errors up to a tenth of this share."
        " Without it 0.1, and 0.02 where a recording is the scene, whose own errors count beside.",
    ),
    "split": Option(
        default="frames,pixels",
        choices=get_args(Split),
        help="Data held out from the fit: frames, pixels or both.",
    ),
}
"""Options of `tofmix.reconciliation.settings.Settings`, but for the kinds of effects."""
