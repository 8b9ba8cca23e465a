"""Thresholds of unmixing, each with its unit; `unmix` takes them.

A value out of its bounds raises UsageError.

docs/results/mixing.md shows what the defaults find.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from tofmix.bounds import (
    Count,
    FactorThreshold,
    NotNegative,
    Positive,
    PositiveThreshold,
    Share,
    Threshold,
    WholeNumber,
    check_bounds,
    checked,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageSettings:
    """Errors of the mean phasors.

    Parameters
    ----------
    least_samples : int
        Samples from which on a pixel's mean phasor is used.
    prior_samples : float
        Samples that the neighbours' noise counts for in a pixel's own: with few frames its own variances are uncertain.
    most_noise : float
        Largest factor on the neighbours' noise of a single surface: more scatter may be two surfaces.
    """

    least_samples: Count = 3
    prior_samples: NotNegative = 8.0
    most_noise: FactorThreshold = 1.5

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedSettings:
    """Pixels that surely see one surface.

    Parameters
    ----------
    rare : float
        Chance that a window of one surface is passed over, 0 to 1.
    quantiles : tuple of float
        Parts of the windows, 0 to 1, that are taken to be of one surface each: the smaller scatter counts.
    least_windows : int
        Windows from which on a scatter beyond noise is measured.
    most_pattern : float
        Largest standard deviation of a fixed pattern, rad of phase: a tenth is 1.6 % of the unambiguous range.
    unlike_sigmas : float
        Standard errors from the neighbouring planes, beyond which a pixel at a border is tested again: more than noise
        gives.
    between_sigmas, different_sigmas : float
        Standard errors that a pixel is off both sides, and that these differ by, where it may be a mixture of both.
    """

    rare: Share = 1.0e-3
    quantiles: tuple[Share, ...] = (0.1, 0.25)
    least_windows: Count = 20
    most_pattern: Positive = 0.1
    unlike_sigmas: Threshold = 2.5
    between_sigmas: Threshold = 1.0
    different_sigmas: Threshold = 5.0

    def __post_init__(self) -> None:
        check_bounds(self)


@checked
class NeighbourSettings(NamedTuple):
    """The surfaces beside a pixel; a tuple, as kernels take it.

    Parameters
    ----------
    reach, near : int
        Reach of the window, pixels, and distance within which a surface must have a pixel.
    beside : int
        Distance, pixels, within which a surface has a pixel if it fills one of the eight around: 1, or 2 where only the
        sure pixels of surfaces are known, as the pixels next to these may be theirs, too.
    apart_sigmas, apart : float
        Standard errors, and part of 1 / r, that lie between the predictions of two surfaces.
    outlier : float
        Square of a residual over its variance, of a pixel that belongs to another surface after all.
    free_slope, known_slope : float
        Standard deviation of a slope, in units of pitch / r, before it is measured: 2 is a surface seen at 27 degrees
        from grazing; where pixels bring planes of their own, these are right to a few degrees.
    light_slope, least_light_slope : float
        Standard deviation of a slope of u = ln A + 3 ln r, a pixel: in pitches, as the light of a lamp falls towards
        the image's corners, and what is added, half a percent.
    light_reach : float
        Standard deviation, pixels, of the weights that u is fitted with: light varies where ranges do not.
    chance_sigmas : float
        Standard deviations of a mean square of residuals that are chance.
    """

    reach: Count = 4
    near: Count = 3
    beside: Count = 1
    apart_sigmas: Threshold = 4.0
    apart: Threshold = 0.01
    outlier: PositiveThreshold = 16.0
    free_slope: Positive = 2.0
    known_slope: Positive = 0.25
    light_slope: NotNegative = 2.0
    least_light_slope: Positive = 0.005
    light_reach: Positive = 2.0
    chance_sigmas: Threshold = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneSettings:
    """Planes of large surfaces, which are continued over the whole image.

    Parameters
    ----------
    least_pixels : int
        Pixels of such a surface: its slopes are then sure to a percent.
    most_regions, most_planes : int
        Connected regions that are looked at, the largest first, and planes that are looked for in each.
    tries : int
        Random triples of pixels: with half of them on one plane, 25 triples miss it once in 30 regions.
    line_tries : int
        Likewise among narrow surfaces, with a third of them on one plane.
    least_width : float
        Pixels across all narrow surfaces on such a plane: two lines that are parallel always lie on one, a third tests
        it. Lines have gaps.
    light_slope, light_step : float
        Standard deviation of u = ln A + 3 ln r over such a plane, in pitches, and what is added: that of one step to
        the next pixel of a surface.
    inlier_sigmas : float
        Distance from a plane, standard deviations, up to which a pixel belongs to it.
    extrapolated : float
        Factor on the variance of a plane outside of its pixels: real walls are flat to about their noise.
    """

    least_pixels: Count = 30
    most_regions: WholeNumber = 20
    most_planes: WholeNumber = 3
    tries: WholeNumber = 25
    line_tries: WholeNumber = 100
    least_width: PositiveThreshold = 2.5
    light_slope: NotNegative = 2.0
    light_step: Positive = 0.005
    inlier_sigmas: PositiveThreshold = 4.0
    extrapolated: Positive = 4.0

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class HypothesisSettings:
    """What the mean phasor of a pixel is of.

    Parameters
    ----------
    distant_prior : float
        Prior of a large surface elsewhere, and of pairs with one: small, so that a pair at the same range by chance
        stays a pair.
    likely : float
        Probability from which on neighbouring surfaces explain a pixel, and large ones elsewhere are not tried.
    aside : float
        Chance that a surface which a pixel sees fills none of the eight pixels around it: 0.001 to 0.04 in simulated
        scenes of boards, pickets, rooms and stairs, where it fills any within four pixels.
    near_chord : float
        Distance from a chord, as a part of its length and beyond 6 standard errors, within which a pair is tried.
    apart_sigmas, apart : float
        Standard errors, and part of the range, between the surfaces of a pair.
    same_sigmas : float
        A pair whose share of a thin surface is 1 within so many standard errors is that surface, without new
        information.
    rounds : int
        Rounds of share and place: a surface is seen where its part of the pixel is, and that is as large as the share.
    bend_radius : float
        Radius of a thing that bends, pixels, of which too few pixels show how much: half of the width of a patch.
    unseen : float
        Part of the pairs beside things that bend in which one surface has no pixel nearby that sees it alone: 0 to 0.5
        in simulated scenes of hands, cups, rods and balls.
    """

    distant_prior: Share = 0.002
    likely: Share = 0.9
    aside: Share = 0.01
    near_chord: Threshold = 0.02
    apart_sigmas: Threshold = 5.0
    apart: Threshold = 0.02
    same_sigmas: Threshold = 3.0
    rounds: Count = 3
    bend_radius: Positive = 2.0
    unseen: Share = 0.1

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelSettings:
    """Rounds in which pixels are judged by those around them.

    Parameters
    ----------
    rounds : int
        Times that pixels in doubt are judged; with 0 their layers stay as they are.
    open_reach : int
        Pixels from open space within which a pixel may see some of it.
    least_open : int
        Fewest pixels of open space for an estimate of its return; with fewer, it returns nothing.
    agree_sigmas : float
        Standard errors up to which neighbouring pixels agree.
    slope, light_slope : float
        Standard deviation of the step to the next pixel of one surface, in units of the pitch: of range as a part of
        it, and of u = ln A + 3 ln r.
    light_step : float
        What is added to that of u: half a percent.
    """

    rounds: WholeNumber = 3
    open_reach: WholeNumber = 3
    least_open: Count = 3
    agree_sigmas: Threshold = 3.0
    slope: Positive = 2.0
    light_slope: NotNegative = 2.0
    light_step: Positive = 0.005

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvedSettings:
    """Pixels beside surfaces that bend.

    Parameters
    ----------
    rounds : int
        Most times that pixels join surfaces; with 0 all surfaces are planes.
    decided : float
        Posterior from which on planes explain a mixed pixel, 0 to 1.
    sure : float
        Posterior from which on a surface that fills a pixel has it.
    beside : int
        Pixels from a surface, within which a pixel may join it.
    least_share : float
        Share of the lesser surface below which a pixel is of one surface.
    """

    rounds: WholeNumber = 8
    decided: Share = 0.5
    sure: Share = 0.9
    beside: Count = 2
    least_share: NotNegative = 0.02

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawSettings:
    """Which law of mixing holds at the edges.

    Parameters
    ----------
    least_phasor_share : float
        Share of phasor sums from which on layers are unmixed, 0 to 1: below, the samples themselves show the surfaces.
    chance_sigmas : float
        Standard errors above 0 from which on such a share is no chance.
    least_probability : float
        Smallest posterior of pairs that measure q.
    least_share : float
        Least share of a pair's lesser surface: w (1 - w) is known well there.
    most_error : float
        Largest standard error of q of a pixel that measures q.
    least_error : float
        Least standard error of a pixel's q: shares and chords are known no better.
    reach, least_along : int
        Reach of the window, pixels, in which the q of an edge is measured, and the fewest pixels in it.
    different_sigmas : float
        Standard errors by which an edge differs from the others of the image before its own law is taken.
    noisiest : float
        Quantile of the scatter of pixels that see one surface, 0 to 1, which counts as their noise: dark surfaces
        scatter more than bright ones.
    least_differing : float
        Part of the pixels that measure q, which the pixels at edges of another q must exceed. By their probability, one
        in 100 of the certain pairs may have a wrong surface. These lie together, at a corner, or next to a surface that
        no pixel sees alone.
    """

    least_phasor_share: Threshold = 0.05
    chance_sigmas: Threshold = 3.0
    least_probability: Share = 0.9
    least_share: Share = 0.15
    most_error: PositiveThreshold = 0.5
    least_error: Positive = 0.02
    reach: Count = 3
    least_along: Count = 5
    different_sigmas: Threshold = 4.0
    noisiest: Share = 0.9
    least_differing: Share = 0.05

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnfoldingSettings:
    """Which surfaces stand one turn beyond the fold.

    Parameters
    ----------
    least_pixels : int
        Fewest pixels of a surface that is unfolded; fewer may be mixtures.
    link_sigmas, link_pitches : float
        Standard errors, and steps of a pixel's width, between neighbours of one surface: 76 degrees of incidence.
    crossed : float
        Pairs of neighbours across the fold, as a part of the square root of a surface's pixels, from which on it
        crosses the fold: a fifth of one side.
    strides : tuple of int
        Distances, in pixels, over which light is compared: a larger distance tests a wide surface better.
    better : float
        Ratio of the scatter of light with the turn to that without it, below which the turn is taken.
    """

    least_pixels: Count = 12
    link_sigmas: Threshold = 4.0
    link_pitches: Threshold = 4.0
    crossed: Threshold = 0.2
    strides: tuple[Count, ...] = (4, 16)
    better: Threshold = 0.7

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnmixSettings:
    """All thresholds of unmixing.

    Parameters
    ----------
    image, seeds, neighbours, planes, hypotheses, labels, curved, law, unfolding
        Of these steps.
    least_probability : float
        Posterior from which on a mixed pixel is decided, 0 to 1.
    most_fresh_probability : float
        Most probability of a layer that rests on a surface which no pixel surely sees alone: pixels that agree with
        their neighbours may be equal mixtures. In a fence of pales two pixels wide 84 to 100 % of such layers are
        right.
    open_share : float
        Least share without a return of a pixel that sees no surface at all, 0 to 1.
    dimmest : float
        Part of the pixels with a surface, 0 to 1, whose light open space does not exceed.
    unknown_pitch : float
        Tangent of the angle between pixels of a camera whose optics are not known: 0.3 degrees. Planes in windows of a
        few pixels do not depend on it.
    """

    image: ImageSettings = field(default_factory=ImageSettings)
    seeds: SeedSettings = field(default_factory=SeedSettings)
    neighbours: NeighbourSettings = field(default_factory=NeighbourSettings)
    planes: PlaneSettings = field(default_factory=PlaneSettings)
    hypotheses: HypothesisSettings = field(default_factory=HypothesisSettings)
    labels: LabelSettings = field(default_factory=LabelSettings)
    curved: CurvedSettings = field(default_factory=CurvedSettings)
    law: LawSettings = field(default_factory=LawSettings)
    unfolding: UnfoldingSettings = field(default_factory=UnfoldingSettings)
    least_probability: Share = 0.5
    most_fresh_probability: Share = 0.9
    open_share: Share = 0.5
    dimmest: Share = 0.1
    unknown_pitch: Positive = 0.005

    def __post_init__(self) -> None:
        check_bounds(self)


DEFAULT_SETTINGS = UnmixSettings()
