"""Thresholds of surfaces and edges, each with its unit; `reconstruct` takes them.

A value out of its bounds raises UsageError.

They are tuples, so that kernels take them too.

docs/results/surfaces.md shows what the defaults find.
"""

from typing import NamedTuple

from tofmix.bounds import Count, NotNegative, Positive, PositiveThreshold, Share, Threshold, WholeNumber, checked


@checked
class LinkSettings(NamedTuple):
    """Which layers are of one surface.

    Parameters
    ----------
    least_probability : float
        A layer that is less sure is of no surface, 0 to 1.
    unknown_error : float
        Relative error of a range whose standard error is not known.
    prior_slope : float
        Standard deviation of a surface's slope, tangent of the angle off the beam, before its neighbours are seen.
    most_sigmas : float
        A layer is on a plane that it misses by up to this many standard deviations.
    surface_cost : float
        Cost of a surface, shared by its layers, as a squared misfit: its three numbers, each known to one in a hundred.
    apart_cost : float
        Cost of a neighbouring pixel that does not see a layer's surface, in squared standard deviations.
    sweeps : int
        Most passes that give layers to planes anew.
    least_piece : int
        Layers from which on a piece of a surface may be joined to another that it does not touch.
    same_plane_odds : float
        Odds that two pieces are of one plane, before their planes are compared.
    slight_misfit : float
        Mean squared misfit that joining may add, in variances: half a standard deviation a layer cannot be seen.
    least_layers : int
        Layers of a surface at least: a plane has three numbers.
    rounds : int
        Most rounds in which layers at its rim join a smooth surface.
    """

    least_probability: Share = 0.5
    unknown_error: Positive = 0.01
    prior_slope: Positive = 1.5
    most_sigmas: Positive = 4.0
    surface_cost: NotNegative = 28.0
    apart_cost: NotNegative = 0.5
    sweeps: WholeNumber = 4
    least_piece: Count = 8
    same_plane_odds: Positive = 0.01
    slight_misfit: Threshold = 0.25
    least_layers: Count = 3
    rounds: WholeNumber = 8


@checked
class ShareSettings(NamedTuple):
    """What pixels see, and where a surface ends.

    Parameters
    ----------
    least_open_samples : float
        Samples without a return from which on a pixel sees open space: fewer may be lost by chance.
    unseen_share : float
        Error of the share of a pixel with one surface, where shares are unmixed: half the share below which unmixing
        finds no second surface.
    common_variance : float
        Part of an unmixed share's variance from the phasors of the neighbouring surfaces. A surface is fitted in half
        a window of 9 x 9 pixels, its light with a weight that falls with a standard deviation of 2
        pixels. That is some 12 to 25 pixels, and the fit is continued from their middle to the pixel: its variance is
        0.1 to 0.3 of a pixel's own, for each of both surfaces.
    crease : float
        Relative gap between two surfaces at the border of two pixels, from which on one ends there: less may be a
        crease.
    border_margin : float
        Distance beyond a pixel's border, pixels, up to which an edge at the border is the pixel's own.
    most_off : float
        Relative distance of a layer from its surface's plane, beyond which the fine image has the layer's own range.
    """

    least_open_samples: Threshold = 3.0
    unseen_share: Share = 0.03
    common_variance: Share = 0.25
    crease: NotNegative = 0.03
    border_margin: NotNegative = 0.003
    most_off: Threshold = 0.1


@checked
class BrightnessSettings(NamedTuple):
    """How bright a surface is, where shares of samples are not shares of the area.

    Parameters
    ----------
    reach : int
        Pixels around, whose light tells the brightness.
    least_pixels : int
        Pixels inside a surface from which on its outermost ones do not count: a second surface may dim these.
    slope : float
        Standard deviation of the change of the logarithm of light from pixel to pixel, before it is seen.
    least_scatter_pixels : int
        Pixels from which on the scatter of a surface's light is measured.
    usual_scatter, least_scatter : float
        Scatter of the logarithm of light where it is not measured, and at least.
    least_samples : float
        Samples that tell the odds of two surfaces at least.
    unseen_samples : float
        Samples of a second surface up to which it may not be found.
    missing_sigmas : float
        Standard deviations of missing light from which on another surface has the rest of the pixel.
    """

    reach: Count = 4
    least_pixels: Count = 3
    slope: Positive = 0.02
    least_scatter_pixels: Count = 8
    usual_scatter: Positive = 0.05
    least_scatter: Positive = 1e-3
    least_samples: Positive = 0.5
    unseen_samples: Threshold = 3.0
    missing_sigmas: Threshold = 2.0


@checked
class EdgeSettings(NamedTuple):
    """Edges through runs of pixels, and what they cover.

    Parameters
    ----------
    longest_run : int
        Pixels on each side that a run grows to at most.
    fast_run : float
        Pixels on a side from which on a run grows by two at a time.
    first_turn : float
        Change of direction, rad, that a run may have after its first pixels.
    steps : int
        Steps of Levenberg and Marquardt's method after a run has grown.
    agree_sigmas : float
        Standard deviations up to which a run agrees: one in a thousand that belongs to it does not.
    curvature_gain, corner_gain : float
        Chi-square that a curvature, or a corner, must save: three standard errors. A short edge of its own must save as
        much as a corner does, beside its corners.
    half_width : float
        Distance from the edge, pixels, up to which pixels are of its run.
    most_curvature : float
        Largest curvature, 1/pixel: an arc of a smaller circle is hidden in a few pixels.
    short_run : float
        A run shorter than this on one side, pixels, may end at a corner.
    around : int
        Pixels around, in which an edge's neighbours are continued.
    most_edges : int
        Edges that are compared in a pixel at most: the ones with the longest runs.
    same_angle, same_place : float
        Two edges within this, rad and pixels, are one.
    graze_area : float
        Area of a pixel below which an edge that grazes it changes nothing: less than half a part of 16 x 16.
    graze_sigmas : float
        A pixel of one surface may see another one up to this many standard errors of its share.
    alike_distance : float
        Distance h, pixels: two pixels that are d apart have a part exp(-(d / h)^2) of that in common, as it is for
        weights of a standard deviation of 2 pixels.
    """

    longest_run: Count = 12
    fast_run: Threshold = 4.0
    first_turn: Positive = 0.15
    steps: Count = 4
    agree_sigmas: PositiveThreshold = 3.0
    curvature_gain: Threshold = 9.0
    corner_gain: Threshold = 9.0
    half_width: Positive = 1.5
    most_curvature: PositiveThreshold = 0.3
    short_run: Threshold = 3.0
    around: WholeNumber = 3
    most_edges: WholeNumber = 8
    same_angle: Threshold = 0.15
    same_place: Threshold = 0.25
    graze_area: NotNegative = 0.002
    graze_sigmas: Threshold = 3.0
    alike_distance: Positive = 4.0


@checked
class SurfaceSettings(NamedTuple):
    """All thresholds of surfaces.

    Parameters
    ----------
    link, share, brightness, edge
        Of these steps.
    """

    link: LinkSettings = LinkSettings()
    share: ShareSettings = ShareSettings()
    brightness: BrightnessSettings = BrightnessSettings()
    edge: EdgeSettings = EdgeSettings()


DEFAULT_SETTINGS = SurfaceSettings()
