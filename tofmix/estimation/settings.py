"""Options of the estimator, and their form for the kernels."""

from dataclasses import dataclass, field, fields
from enum import StrEnum
from statistics import NormalDist
from typing import NamedTuple

from tofmix.estimation.peaks.counters import COUNTERS, Counter, Kde
from tofmix.options import ESTIMATE, check_options
from tofmix.sensor import Sensor


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

    `tofmix.options.ESTIMATE` tells each option, and has its default and its bounds. `counter` is one of
    `tofmix.estimation.peaks.counters.COUNTERS`. With `paper`, of the other options only `max_layers`, `min_samples` and
    gamma of the counter ``kde`` have a meaning; `sigma`, `refine`, `max_iter` and `mixing` are set to the paper's.

    Raises
    ------
    ValueError
        If a value is out of its bounds.
    """

    sigma: SigmaMode = ESTIMATE["sigma"].default
    max_layers: int = ESTIMATE["max_layers"].default
    counter: Counter = field(default_factory=Kde)
    refine: Refine = ESTIMATE["refine"].default
    false_alarm: float = ESTIMATE["false_alarm"].default
    max_iter: int = ESTIMATE["max_iter"].default
    tol: float = ESTIMATE["tol"].default
    min_samples: int = ESTIMATE["min_samples"].default
    unambiguous_range_mm: float | None = None
    mixing: MixingChoice = ESTIMATE["mixing"].default
    paper: bool = False

    def __post_init__(self) -> None:
        if self.paper:
            if not isinstance(self.counter, Kde):
                raise ValueError("paper: its algorithm counts by kernel density; leave out the other counter")
            if self.unambiguous_range_mm is not None:
                raise ValueError("paper: its algorithm has no wrapped range axis; leave out the unambiguous range")
            for name, value in _OF_PAPER.items():
                object.__setattr__(self, name, value)
        check_options(self, ESTIMATE)
        if not isinstance(self.counter, tuple(COUNTERS.values())):
            kinds = ", ".join(f"{kind.__name__}()" for kind in COUNTERS.values())
            refusal = f"counter: {self.counter!r} is not one of {kinds}, of tofmix.estimation.peaks.counters"
            raise ValueError(refusal)  # noqa: TRY004  as any other bad option
        for name, kind in _CHOICES.items():
            object.__setattr__(self, name, kind(getattr(self, name)))

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
