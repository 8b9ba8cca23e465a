"""Thresholds of the measurement of noise, each with its unit; `measure_noise` takes them.

A value out of its bounds raises UsageError.
"""

from dataclasses import dataclass, field

from tofmix.bounds import (
    AtLeastTwo,
    Count,
    Finite,
    NotNegative,
    Positive,
    RatioAbove1,
    Share,
    check_ascending,
    check_bounds,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveSettings:
    """The curve sigma(r) through bins of range.

    Parameters
    ----------
    least_in_bin : int
        Fewest series that determine a sigma.
    bin_target : int
        Series of a bin, where there are enough.
    most_bins : int
        Bins of range at most.
    wide, narrow : float
        Extent of a bin over its range: above the first it is split, below the second it never is.
    gap : float
        A step in range, over the range, that parts two bins.
    slopes : (float, float)
        Least and greatest power of range by which sigma is carried on past the outer bins.
    fill : float
        Ratio of neighbouring points of the curve where nothing was seen, above 1.
    least_smoothed : int
        Fewest bins that determine the smoothness of the curve.
    """

    least_in_bin: Count = 20
    bin_target: Count = 60
    most_bins: Count = 64
    wide: Positive = 0.12
    narrow: NotNegative = 0.02
    gap: Positive = 0.03
    slopes: tuple[Finite, Finite] = (-1.0, 4.0)
    fill: RatioAbove1 = 1.15
    least_smoothed: Count = 4

    def __post_init__(self) -> None:
        check_bounds(self)
        check_ascending(self, "slopes")


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeSettings:
    """How noise depends on amplitude.

    Parameters
    ----------
    exponents : (float, float)
        Least and greatest power by which noise falls with amplitude: shot noise gives 1, as does background light.
    pieces : tuple of int
        Powers of one law, each over its own part of the amplitudes: the numbers that are tried, ascending.
    ends : (float, float)
        Quantiles of the amplitudes between which a law is told.
    folds : int
        Parts of the pixels for cross-validation.
    least_gain : float
        Least gain of held-out likelihood, nat, of a law over the one with fewer pieces.
    least_errors : float
        The gain must also be that many of its standard errors over the series: a few of them must not decide.
    least_effect : float
        Least standard deviation of log sigma that a law makes among the series of a bin: 0.025 is 5 % from bright to
        dark.
    least_series, most_series : int
        Series with amplitudes: fewer are not asked for a law, and of more some are fitted, spread over all.
    """

    exponents: tuple[Finite, Finite] = (0.0, 2.0)
    pieces: tuple[Count, ...] = (1, 2, 3)
    ends: tuple[Share, Share] = (0.005, 0.995)
    folds: AtLeastTwo = 5
    least_gain: NotNegative = 10.0
    least_errors: NotNegative = 2.0
    least_effect: NotNegative = 0.025
    least_series: Count = 100
    most_series: Count = 20_000

    def __post_init__(self) -> None:
        check_bounds(self)
        check_ascending(self, "exponents", "pieces", "ends")


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlierSettings:
    """The share of random values.

    Parameters
    ----------
    far_sigmas : float
        Samples that are farther from the surface are no noise.
    neighbour_sigmas : float
        Two of them that are nearer to each other are a weak surface.
    cells : int
        Parts of the working range.
    least_in_cell : int
        Outliers a part on average, from which the median part tells.
    suspect_factor : float
        A series whose spread is that many times sigma(r) may see two surfaces.
    """

    far_sigmas: Positive = 5.0
    neighbour_sigmas: NotNegative = 3.0
    cells: Count = 20
    least_in_cell: Count = 5
    suspect_factor: Positive = 1.35

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseSettings:
    """All thresholds of the measurement of noise.

    Parameters
    ----------
    curve, amplitude, outliers
        Of these steps.
    strictness : float
        Share of Gaussian series that each test of shape turns away, 0 to 1: it costs no bias.
    least_fitting : float
        Share of series that must have the shape of one surface for the tests of shape to count, 0 to 1.
    pile_sigma : float
        Samples without a return with less than this share of their neighbour's sigma are a constant.
    """

    curve: CurveSettings = field(default_factory=CurveSettings)
    amplitude: AmplitudeSettings = field(default_factory=AmplitudeSettings)
    outliers: OutlierSettings = field(default_factory=OutlierSettings)
    strictness: Share = 0.1
    least_fitting: Share = 0.1
    pile_sigma: NotNegative = 0.5

    def __post_init__(self) -> None:
        check_bounds(self)


DEFAULT_SETTINGS = NoiseSettings()
