"""Options of the estimator, and their form for the kernels."""

import math
from dataclasses import dataclass, field, fields
from enum import StrEnum
from numbers import Integral, Real
from statistics import NormalDist
from typing import NamedTuple

from tofmix.estimation.mixture.false_alarms import check_false_alarm
from tofmix.estimation.peaks.counters import COUNTERS, Counter, Kde
from tofmix.layers import MAX_LAYERS_LIMIT
from tofmix.sensor import Sensor

LEAST_SAMPLES = 2
"""Samples below which nothing can be fitted: no layer rests on a single one."""


class Refine(StrEnum):
    """Use of the peaks of step 1."""

    LIKELIHOOD = "likelihood"
    NONE = "none"


class SigmaMode(StrEnum):
    """How a component's sigma is found."""

    TIED = "tied"
    PRIOR = "prior"
    FREE = "free"


class MixingChoice(StrEnum):
    """Which law of mixing is taken to hold where a pixel sees several surfaces."""

    AUTO = "auto"
    EVENTS = "events"
    PHASOR = "phasor"


_CHOICES: dict[str, type[StrEnum]] = {"sigma": SigmaMode, "refine": Refine, "mixing": MixingChoice}
_OF_PAPER = {"mixing": "events", "sigma": "free", "refine": "none", "max_iter": 50}
_WITHOUT_MEANING = ("false_alarm", "tol", "epsilon")


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateOptions:
    """Every choice that affects the values of an estimate.

    Parameters
    ----------
    sigma : SigmaMode
        ``tied``: sigma_i = sigma(mu_i); ``prior``: a prior around it; ``free``: the paper's form.
    max_layers : int
        Most surfaces kept in a pixel, 1 to 32; the weakest are left out.
    counter : Counter
        How step 1 counts, with its parameters; one of `tofmix.estimation.peaks.counters.COUNTERS`.
    refine : Refine
        ``likelihood``: count by likelihood, from the peaks; ``none``: the peaks are the surfaces, as in the paper.
    false_alarm : float
        Chance that a pixel of one surface gets more than one, 10^-6 to 0.1.
    max_iter : int
        Most EM iterations, at least 1.
    tol : float
        EM stops when no mean moves by more than `tol` sigma and no weight by more than `tol`.
    min_samples : int
        Fewest valid samples that a pixel is fitted with, at least 2.
    unambiguous_range_mm : float or None
        Length of the circle that ranges are on, mm, finite and above 0: a surface at the fold is one surface. None:
        ranges are on a line, and nothing folds.
    mixing : MixingChoice
        ``auto``: measured from the scatter of samples, where these are phasors; ``events``: each sample is of one
        surface, as equation (1) has it; ``phasor``: each sample is the phasor sum of all surfaces in the pixel.
    paper : bool
        Whether each pixel is fitted by the paper's algorithm as it is printed (`tofmix.estimation.paper`). Of the other
        options only `max_layers`, `min_samples` and gamma of the counter ``kde`` then have a meaning; `sigma`,
        `refine`, `max_iter` and `mixing` are set to the paper's.

    Raises
    ------
    ValueError
        If a value is out of these bounds.
    """

    sigma: SigmaMode = SigmaMode.PRIOR
    max_layers: int = 6
    counter: Counter = field(default_factory=Kde)
    refine: Refine = Refine.LIKELIHOOD
    false_alarm: float = 1.0e-3
    max_iter: int = 50
    tol: float = 1.0e-3
    min_samples: int = 3
    unambiguous_range_mm: float | None = None
    mixing: MixingChoice = MixingChoice.AUTO
    paper: bool = False

    def __post_init__(self) -> None:
        if self.paper:
            if not isinstance(self.counter, Kde):
                raise ValueError("paper: its algorithm counts by kernel density; leave out the other counter")
            if self.unambiguous_range_mm is not None:
                raise ValueError("paper: its algorithm has no wrapped range axis; leave out the unambiguous range")
            for name, value in _OF_PAPER.items():
                object.__setattr__(self, name, value)
        self._check_types()
        for name, kind in _CHOICES.items():
            value = getattr(self, name)
            if value not in list(kind):
                raise ValueError(f"{name}: {value!r} is not one of {', '.join(kind)}")
            object.__setattr__(self, name, kind(value))
        check_false_alarm(self.false_alarm)
        length = self.unambiguous_range_mm
        bounds = (
            (length is None or 0 < length < math.inf, "unambiguous_range_mm", "finite and above 0"),
            (1 <= self.max_layers <= MAX_LAYERS_LIMIT, "max_layers", f"1 to {MAX_LAYERS_LIMIT}"),
            (1 <= self.max_iter < 2**16, "max_iter", "1 to 65535"),
            (0 < self.tol < 1, "tol", "in (0, 1)"),
            (self.min_samples >= LEAST_SAMPLES, "min_samples", f"at least {LEAST_SAMPLES}"),
        )
        for fits, name, text in bounds:
            if not fits:
                raise ValueError(f"{name}: {getattr(self, name)} is not {text}")

    def _check_types(self) -> None:
        """Refuse values of another type than declared, which later code would take for something else."""
        for name in ("max_layers", "max_iter", "min_samples"):
            value = getattr(self, name)
            if not isinstance(value, Integral) or isinstance(value, bool):
                raise ValueError(f"{name}: {value!r} is not a whole number")  # noqa: TRY004  as any other bad option
        for name in ("false_alarm", "tol", "unambiguous_range_mm"):
            value = getattr(self, name)
            if value is not None and (not isinstance(value, Real) or isinstance(value, bool)):
                raise ValueError(f"{name}: {value!r} is not a number")
        if not isinstance(self.paper, bool):
            raise ValueError(f"paper: {self.paper!r} is neither True nor False")  # noqa: TRY004  as any other bad option
        if not isinstance(self.counter, tuple(COUNTERS.values())):
            kinds = ", ".join(f"{kind.__name__}()" for kind in COUNTERS.values())
            refusal = f"counter: {self.counter!r} is not one of {kinds}, of tofmix.estimation.peaks.counters"
            raise ValueError(refusal)  # noqa: TRY004  likewise

    def as_dict(self) -> dict[str, str | int | float]:
        """The options by name, with those of the counter, for provenance; without options that are None.

        The law of mixing is an option only where it is measured or insisted on: ``events`` is left out.
        """
        values = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}
        names = {kind: name for name, kind in COUNTERS.items()}
        if self.mixing is MixingChoice.EVENTS:
            del values["mixing"]
        else:
            values["mixing"] = self.mixing.value
        chosen = {"sigma": self.sigma.value, "refine": self.refine.value, "counter": names[type(self.counter)]}
        options = values | chosen | self.counter.as_dict()
        without = _WITHOUT_MEANING if self.paper else ("paper",)
        return {name: value for name, value in options.items() if name not in without}


class KernelOptions(NamedTuple):
    """`EstimateOptions` as the kernels read them; `mode` is 0 tied, 1 prior, 2 free."""

    mode: int
    refine: bool
    false_alarm: float
    no_return_gain: float
    max_layers: int
    max_iter: int
    tol: float
    min_samples: int


MODE_TIED, MODE_PRIOR, MODE_FREE = 0, 1, 2  # `SigmaMode` as the kernels read it


def no_return_gain(false_alarm: float) -> float:
    """Gain, nat, of c_0 in the presence of a surface that noise exceeds with the probability `false_alarm`.

    c_0 has one free number, its share, which cannot fall below 0: without c_0 twice its gain is 0 in half of the
    pixels, and chi-squared with one degree of freedom in the other half.

    References
    ----------
    Self and Liang, Journal of the American Statistical Association 82, 1987, case 5,
    doi:10.1080/01621459.1987.10478472.
    """
    return 0.5 * NormalDist().inv_cdf(1.0 - false_alarm) ** 2


def kernel_options(options: EstimateOptions) -> KernelOptions:
    """Translate options for the kernels."""
    mode = {SigmaMode.TIED: MODE_TIED, SigmaMode.PRIOR: MODE_PRIOR, SigmaMode.FREE: MODE_FREE}[options.sigma]
    return KernelOptions(
        mode=mode,
        refine=options.refine is Refine.LIKELIHOOD,
        false_alarm=float(options.false_alarm),
        no_return_gain=no_return_gain(options.false_alarm),
        max_layers=options.max_layers,
        max_iter=options.max_iter,
        tol=float(options.tol),
        min_samples=options.min_samples,
    )


def counts_with_learnt(sensor: Sensor, options: EstimateOptions) -> bool:
    """Whether surfaces are counted under the sensor's learnt noise.

    Not with free sigmas, nor where peaks are surfaces: these ways of the paper have Gaussian noise.
    """
    return sensor.learnt is not None and options.refine is Refine.LIKELIHOOD and options.sigma is not SigmaMode.FREE
