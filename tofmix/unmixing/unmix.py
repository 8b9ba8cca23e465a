"""Unmix one window: the entry for everything that has layers and mean phasors of a whole image.

Ranges that fold: which surfaces lie beyond the fold, one turn farther than their folded ranges.

On a folded axis a surface beyond the fold is no plane: 1 / r is linear in the beam for the true range alone, and so is
ln A + 3 ln r a constant. Use `unfolded` before planes are fitted. Only the first and second turn are distinguished;
ranges in the farther half of a turn stay as they are.

From labels to layers: unmixed layers replace those of mixed pixels.

`warm_up` compiles the kernels of unmixing, or loads them from the cache: they run once on a made-up image.

`measure_law` decides which law holds at the edges: samples of one surface each, as in equation (1), or phasor sums. A
pixel's mean phasor is the same under both; the scatter of its samples along the chord is not. Samples of one surface
each jump between both ends: they scatter along the chord with w (1 - w) |z_A - z_B|^2 more than the noise that the two
surfaces have where they are seen alone. With the share q of phasor sums, a part 1 - q of that is left.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.circle import fold
from tofmix.flags import MOST_UNDECIDED, Mixing, Status
from tofmix.image.patch import STATE, TangentFrame, meet
from tofmix.image.segments import components, count_around
from tofmix.layers import Layers, layer_fields
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import beam_directions_of
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.unmixing.curved_labels import label_curved
from tofmix.unmixing.image import PhasorImage, make_image, mean_phasors, phase_scale_mm, places, variance_along, window
from tofmix.unmixing.labels import Labels, label
from tofmix.unmixing.likeliest import Kind
from tofmix.unmixing.settings import DEFAULT_SETTINGS, LawSettings, UnfoldingSettings, UnmixSettings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixingLaw:
    """Which law holds.

    Parameters
    ----------
    phasor_share : float
        q, the share of the samples at edges that are phasor sums: of edges between surfaces, where there are some.
        Where no pixel determines it: 1 if sums are assumed, NaN if the samples contradict them or there are no edges.
    pixels : int
        Pixels that determine it.
    is_sum : (pixel,) bool
        Whether the pixel's edge has phasor sums: a share of `least_phasor_share` and more, and more than by chance.
    """

    phasor_share: float
    pixels: int
    is_sum: BoolArray


def measure_law(
    image: PhasorImage, labels: Labels, settings: LawSettings, several: BoolArray | None = None
) -> MixingLaw:
    """Measure the share of phasor sums, of the image and of each edge.

    `several` (pixel,): whether the samples show several surfaces, one each; without it, only their scatter counts.

    Edges between surfaces, and edges of a surface next to open space, are measured separately: a camera may sum at one
    kind and not at the other. Where an edge differs from the others of its kind, its own share is taken, if such edges
    have more pixels than wrong surfaces may have.
    """
    value, error = _of_pixels(image, labels, settings)
    informative = error < settings.most_error
    beside_open = np.isinf(labels.range_mm).any(axis=1)
    between = informative & ~beside_open
    main = between if between.any() else informative
    if not main.any():
        return _assumed(image, labels, settings, several)
    share, share_error = _median(value[main], error[main])
    at, at_error = np.full(image.count, share), np.full(image.count, share_error)
    at_open = informative & beside_open
    if at_open.any():
        at[beside_open], at_error[beside_open] = _median(value[at_open], error[at_open])
    # Where surfaces are wrong, q may seem to be known well.
    widest = np.maximum(error, _error(image, labels, at, settings))
    for edges in (~beside_open, beside_open):
        group = informative & edges
        wanted = np.asarray(edges, np.bool_)
        pixels, own, own_error = _along_edges(image, group, wanted, value, widest, settings)
        differs = np.abs(own - at[pixels]) > settings.different_sigmas * np.hypot(own_error, at_error[pixels])
        if group[pixels[differs]].sum() > settings.least_differing * group.sum():
            at[pixels[differs]], at_error[pixels[differs]] = own[differs], own_error[differs]
    is_sum = (at > settings.least_phasor_share) & (at > settings.chance_sigmas * at_error)
    return MixingLaw(phasor_share=share, pixels=int(main.sum()), is_sum=is_sum)


def _assumed(image: PhasorImage, labels: Labels, settings: LawSettings, several: BoolArray | None = None) -> MixingLaw:
    """The law where no edge tells it: sums, the physics of a lock-in camera, unless the samples contradict them.

    Samples of one surface each jump between the surfaces of a pixel: they show several surfaces, or scatter more than
    the noise of pixels that see one surface. Those of a sum do not, whatever the surfaces are. Where few pixels are
    known to see one surface, as behind a mesh, the noise is that of all pixels whose samples do not show several.
    """
    nothing = MixingLaw(phasor_share=float("nan"), pixels=0, is_sum=np.zeros(image.count, bool))
    edge = image.valid & ~labels.is_surface
    alone = image.valid & labels.is_surface
    least_side = 3  # rows and columns of the least window of a plane
    if several is None:
        several = np.zeros(image.count, bool)
    quiet = alone if alone.sum() > edge.sum() else image.valid & ~several
    if not edge.any() or not quiet.any() or min(image.shape) < least_side:
        return nothing  # an image too narrow for planes, or one in which all samples jump
    x, y, both = image.covariance.T
    largest = 0.5 * (x + y) + np.sqrt(0.25 * (x - y) ** 2 + both**2)
    free = np.maximum(image.samples - 1.0, 1.0)
    chance = 1.0 + settings.different_sigmas * np.sqrt(2.0 / free)
    jumps = several | (largest > chance * float(np.quantile(largest[quiet], settings.noisiest)))
    if jumps[edge].mean() > 0.5:  # noqa: PLR2004  most of them
        return nothing
    return MixingLaw(phasor_share=1.0, pixels=0, is_sum=np.ones(image.count, bool))


def _median(value: FloatArray, error: FloatArray) -> tuple[float, float]:
    """Median, and its standard error: that of a mean of Gaussian values, times sqrt(pi / 2)."""
    return float(np.median(value)), math.sqrt(0.5 * math.pi * float((error**2).mean()) / len(value))


def _of_pixels(image: PhasorImage, labels: Labels, settings: LawSettings) -> tuple[FloatArray, FloatArray]:
    """Q of each pixel and its standard error (pixel,), infinite without information."""
    pair, parallel, noise, jump = _along_chords(image, labels, settings)
    value = 1.0 - (1.0 - 1.0 / np.maximum(image.samples, 1.0)) * (parallel - noise) / jump
    error = _error_of(image, parallel, noise, jump, settings.least_error)
    return np.where(pair, value, 0.0), np.where(pair, error, np.inf)


def _error(image: PhasorImage, labels: Labels, share: FloatArray, settings: LawSettings) -> FloatArray:
    """Standard error (pixel,) of a pixel's q where the true one is `share` (pixel,)."""
    pair, _, noise, jump = _along_chords(image, labels, settings)
    parallel = noise + np.clip(1.0 - share, 0.0, 1.0) * jump
    return np.where(pair, _error_of(image, parallel, noise, jump, settings.least_error), np.inf)


def _error_of(
    image: PhasorImage, parallel: FloatArray, noise: FloatArray, jump: FloatArray, least: float
) -> FloatArray:
    free = np.maximum(image.samples - 1.0, 1.0)
    return np.asarray(np.hypot(np.sqrt(2.0 / free) * np.hypot(parallel, noise) / jump, least))


def _along_chords(
    image: PhasorImage, labels: Labels, settings: LawSettings
) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """Pixels whose pair of surfaces is sure, the variance along its chord, that of noise, and that of jumps."""
    share = labels.share[:, 0]
    pair = (labels.kind == Kind.PAIR) & labels.is_known & (labels.probability >= settings.least_probability)
    pair &= (np.abs(share - 0.5) <= 0.5 - settings.least_share) & np.isfinite(labels.scatter)
    length = np.where(pair, np.abs(labels.chord), 1.0)
    jump = np.where(pair, share * (1.0 - share), 1.0) * length**2
    return pair, variance_along(image.covariance, labels.chord / length), np.where(pair, labels.scatter, 0.0), jump


def _along_edges(
    image: PhasorImage,
    group: BoolArray,
    edges: BoolArray,
    value: FloatArray,
    error: FloatArray,
    settings: LawSettings,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Pixels of `edges` with enough of a group around them, the median of q over these, and its standard error.

    A median, because some pixels have wrong surfaces: a pixel that sees only a narrow surface near a chord looks like a
    sum.
    """
    count = count_around(group.reshape(image.shape), settings.reach).ravel()
    pixels = np.flatnonzero(edges & image.valid & (count >= settings.least_along))
    others, inside = places(pixels, image.shape, window(settings.reach, middle=True))
    inside &= group[others]
    size = inside.sum(axis=1)
    ordered = np.sort(np.where(inside, value[others], np.inf), axis=1)
    middle = (np.take_along_axis(ordered, np.stack([(size - 1) // 2, size // 2], axis=1), axis=1)).mean(axis=1)
    square_sum = np.where(inside, error[others], 0.0) ** 2
    return pixels, middle, np.sqrt(0.5 * math.pi * square_sum.sum(axis=1)) / size


def unfolded(
    image: PhasorImage, circle_mm: float, settings: UnfoldingSettings = DEFAULT_SETTINGS.unfolding
) -> FloatArray:
    """Ranges (pixel,), mm, with a turn more for the surfaces beyond the fold.

    Parameters
    ----------
    image : PhasorImage
        Of folded ranges.
    circle_mm : float
        Length of the circle that they are on, mm.
    """
    near = image.valid & (image.range_mm < 0.5 * circle_mm)
    one, other = _neighbours(image, 1)
    reach = settings.link_sigmas * np.sqrt(image.range_variance[one] + image.range_variance[other])
    reach = reach + settings.link_pitches * image.pitch[one] * (image.range_mm[one] + circle_mm)
    gap = image.range_mm[other] - image.range_mm[one]
    both = image.valid[one] & image.valid[other]
    linked = both & near[one] & near[other] & (np.abs(gap) < reach)
    number = components(one[linked], other[linked], image.count)
    size = np.bincount(number[near], minlength=int(number.max()) + 1)
    across = both & (near[one] != near[other]) & (np.abs(circle_mm - np.abs(gap)) < reach)
    at = np.where(near[one], one, other)[across]
    crossings = np.bincount(number[at], minlength=len(size))
    farther = crossings > settings.crossed * np.sqrt(np.maximum(size, 1.0))
    farther |= _is_smoother(image, number, near, circle_mm, settings)
    farther &= size >= settings.least_pixels
    return np.asarray(image.range_mm + circle_mm * (near & farther[number]))


def _neighbours(image: PhasorImage, step: int) -> tuple[IntArray, IntArray]:
    """Pixels (pair,) some steps to the left of others and above them, and these."""
    index = np.arange(image.count).reshape(image.shape)
    return (
        np.concatenate([index[:, :-step].ravel(), index[:-step].ravel()]),
        np.concatenate([index[:, step:].ravel(), index[step:].ravel()]),
    )


def _is_smoother(
    image: PhasorImage, number: IntArray, near: BoolArray, circle_mm: float, settings: UnfoldingSettings
) -> BoolArray:
    """Surfaces (number,) over which ln A + 3 ln r varies less with a turn more, in units of its errors."""
    over = [_is_smoother_over(image, number, near, circle_mm, stride, settings) for stride in settings.strides]
    return np.asarray(np.any(over, axis=0))


def _is_smoother_over(
    image: PhasorImage,
    number: IntArray,
    near: BoolArray,
    circle_mm: float,
    stride: int,
    settings: UnfoldingSettings,
) -> BoolArray:
    """Likewise, between pixels that are `stride` apart."""
    one, other = _neighbours(image, stride)
    same = near[one] & near[other] & (number[one] == number[other])
    one, other = one[same], other[same]
    noise = image.light_variance[one] + image.light_variance[other]
    step = np.log(image.amplitude[other]) - np.log(image.amplitude[one])
    count, total = int(number.max()) + 1, []
    for turn in (0.0, circle_mm):
        first, second = image.range_mm[one] + turn, image.range_mm[other] + turn
        error = noise + 9.0 * (image.range_variance[one] / first**2 + image.range_variance[other] / second**2)
        square = (step + 3.0 * np.log(second / first)) ** 2 / np.maximum(error, np.finfo(float).tiny)
        # The logarithm: a large misfit is an edge of reflectance, and tells nothing.
        total.append(np.bincount(number[one], np.log1p(square), minlength=count))
    pairs = np.bincount(number[one], minlength=count)
    better = (total[1] - total[0]) / np.maximum(pairs, 1) < np.log(settings.better)
    return np.asarray(better & (pairs >= settings.least_pixels))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rewritten:
    """Layers of one window after unmixing.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), with `mixing`.
    phasor_share : float
        q, share of the samples at edges that are phasor sums; NaN if no pixel determines it.
    informative_pixels : int
        Pixels that determine it.
    """

    layers: Layers
    phasor_share: float
    informative_pixels: int


def rewrite(
    layers: Layers,
    image: PhasorImage,
    labels: Labels,
    law: MixingLaw,
    sensor: Sensor,
    *,
    insist: bool,
    circle_mm: float | None = None,
    settings: UnmixSettings = DEFAULT_SETTINGS,
) -> Rewritten:
    """Write the surfaces of mixed pixels over layers.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), as samples of one surface each give them. They are not changed.
    image, labels, law
        Of the same window.
    sensor : Sensor
        Its noise curve gives sigma.
    insist : bool
        Whether all samples at edges are taken as phasor sums, for any measured q.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.

    Returns
    -------
    Rewritten
        Pixels whose samples are of one surface each are as they were.
    """
    shape = layers.shape
    sums = np.ones(image.count, bool) if insist else law.is_sum
    count = layers.n_modes.ravel()
    several = (count > 1) | ((count > 0) & (layers.weight_no_return.ravel() > 0))
    mixing = np.where(several, int(Mixing.EVENTS), int(Mixing.ONE_SURFACE)).astype(np.uint8)
    out = Layers(
        **{spec.name: getattr(layers, spec.name).copy() for spec in layers.fields}, mixing=mixing.reshape(shape)
    )
    if sums.any():
        mixed = np.isin(labels.kind, (Kind.PAIR, Kind.TRIPLE, Kind.EMPTY)) & image.valid
        ends = np.isfinite(labels.range_mm).sum(axis=1)
        decided = (
            mixed & labels.is_known & (labels.probability > settings.least_probability) & (ends <= layers.max_layers)
        )
        flat = out.reshaped((image.count,))
        _write(flat, decided & sums, image, labels, sensor, circle_mm, settings.most_fresh_probability)
        # One surface, says the mean; several, say the samples: as surfaces that move do, which scatter, or by chance.
        contradicted = labels.is_surface & several & (count > 1)
        known = (labels.kind == Kind.CONTINUED) & ~labels.is_fresh & (labels.probability > settings.curved.sure)
        by_chance = contradicted & known & image.valid & sums & ~image.is_noisier(settings.law.different_sigmas)
        contradicted &= ~by_chance
        _write(flat, by_chance, image, _alone(labels, image), sensor, circle_mm, settings.most_fresh_probability)
        flat.mixing[by_chance] = int(Mixing.ONE_SURFACE)  # type: ignore[index]  # it was just made
        _doubt(flat, image.valid & ~decided & sums & (count > 0) & (~labels.is_surface | contradicted))
        fresh = labels.is_surface & ((labels.kind == Kind.NEW) | labels.is_fresh) & sums
        flat.probability[fresh] = np.minimum(flat.probability[fresh], settings.most_fresh_probability)
    return Rewritten(layers=out, phasor_share=law.phasor_share, informative_pixels=law.pixels)


def _alone(labels: Labels, image: PhasorImage) -> Labels:
    """Labels with the return of a whole pixel as its only surface."""
    names = ("range_mm", "range_variance", "share", "share_variance")
    out = {name: np.full_like(getattr(labels, name), np.nan) for name in names}
    for name, values in zip(names, (image.range_mm, image.range_variance, 1.0, 0.0), strict=True):
        out[name][:, 0] = values
    return replace(labels, **out)


def _write(
    flat: Layers,
    pixels: BoolArray,
    image: PhasorImage,
    labels: Labels,
    sensor: Sensor,
    circle_mm: float | None,
    most_fresh: float,
) -> None:
    """Write the surfaces of decided pixels."""
    chosen = np.flatnonzero(pixels)
    if not chosen.size:
        return
    places = labels.range_mm[chosen]
    if circle_mm is not None:
        places = np.where(np.isfinite(places), fold(places, circle_mm), places)
    order = np.argsort(places, axis=1)  # near to far, open space and NaN behind

    def sorted_(values: FloatArray) -> FloatArray:
        return np.take_along_axis(values[chosen], order, axis=1)

    range_mm = np.take_along_axis(places, order, axis=1)
    variance, share, share_variance = (
        sorted_(part) for part in (labels.range_variance, labels.share, labels.share_variance)
    )
    is_surface = np.isfinite(range_mm)
    share = np.where(np.isnan(share), 0.0, share)
    share = share / share.sum(axis=1, keepdims=True)
    returned = 1.0 - sensor.outlier_probability
    sure = np.where(labels.is_fresh, np.minimum(labels.probability, most_fresh), labels.probability)[chosen]
    width = 1.0 if flat.noise_width is None else np.nan_to_num(flat.noise_width[chosen], nan=1.0)[:, np.newaxis]
    curve = sensor.noise
    sigma = (
        np.full(range_mm.shape, np.nan) if curve is None else curve.sigma(np.where(is_surface, range_mm, 0.0)) * width
    )
    columns = min(flat.max_layers, range_mm.shape[1])
    written = {
        "range": range_mm,
        "sigma": sigma,
        "weight": share * returned,
        "range_stderr": np.sqrt(variance),
        "weight_stderr": np.sqrt(share_variance) * returned,
        "probability": np.repeat(sure[:, np.newaxis], range_mm.shape[1], axis=1),
    }
    for name, values in written.items():
        target = getattr(flat, name)
        target[chosen] = np.nan
        target[chosen, :columns] = np.where(is_surface, values, np.nan)[:, :columns]
    if flat.amplitude is not None:
        flat.amplitude[chosen] = np.nan  # a sample is of all surfaces
    flat.n_modes[chosen] = is_surface.sum(axis=1)
    flat.weight_no_return[chosen] = np.where(is_surface, 0.0, share).sum(axis=1) * returned
    flat.weight_outlier[chosen] = sensor.outlier_probability
    log_likelihood = labels.log_density[chosen] - 2.0 * np.log(image.unit)
    flat.log_likelihood[chosen] = np.where(np.isnan(log_likelihood), flat.log_likelihood[chosen], log_likelihood)
    empty = labels.kind[chosen] == Kind.EMPTY
    flat.status[chosen] = np.where(empty, int(Status.NO_SURFACE), int(Status.OK))
    flat.mixing[chosen] = np.where(empty, int(Mixing.ONE_SURFACE), int(Mixing.PHASOR))  # type: ignore[index]  # as above


def _doubt(flat: Layers, pixels: BoolArray) -> None:
    """Mark undecided pixels."""
    flat.probability[pixels] = np.minimum(flat.probability[pixels], MOST_UNDECIDED)
    flat.mixing[pixels] = int(Mixing.UNDECIDED)  # type: ignore[index]  # it was just made


def unmix(
    layers: Layers,
    phasors: Float32Array,
    sensor: Sensor,
    *,
    insist: bool = False,
    circle_mm: float | None = None,
    settings: UnmixSettings = DEFAULT_SETTINGS,
) -> Rewritten:
    """Find the surfaces in the mixed pixels of one window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), as samples of one surface each give them. They are not changed.
    phasors : (row, col, 7) float32
        From `tofmix.unmixing.image.mean_phasors`, of the same window.
    sensor : Sensor
        Its modulation frequency must be known; its optics and noise curve are used if known.
    insist : bool
        Whether all samples at edges are taken as phasor sums, for any scatter.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.

    Returns
    -------
    Rewritten
        Layers with `mixing`, and the law that was found. Where samples are of one surface each (equation (1)), all
        layers are as they were.

    Raises
    ------
    ValueError
        If the modulation frequency is not known.
    """
    if sensor.modulation_frequency_hz is None:
        raise ValueError("unmixing needs the modulation frequency")
    rows, cols = layers.shape
    directions = _directions(sensor, (rows, cols), settings.unknown_pitch)
    scale_mm = phase_scale_mm(sensor.modulation_frequency_hz)
    open_space = _sees_nothing(layers, phasors, settings)
    image = make_image(phasors, directions, scale_mm=scale_mm, open_space=open_space, settings=settings.image)
    if circle_mm is not None:
        image = replace(image, range_mm=unfolded(image, circle_mm, settings.unfolding))
    labels = label_curved(image, label(image, settings), settings)
    law = measure_law(image, labels, settings.law, layers.n_modes.ravel() > 1)
    return rewrite(layers, image, labels, law, sensor, insist=insist, circle_mm=circle_mm, settings=settings)


def _directions(sensor: Sensor, shape: tuple[int, int], unknown_pitch: float) -> FloatArray:
    """Unit vectors (row, col, 3) along the beams."""
    optics = sensor.optics
    if optics is None:
        focal = 1.0 / unknown_pitch
        optics = Pinhole(fx=focal, fy=focal, cx=(shape[1] - 1) / 2, cy=(shape[0] - 1) / 2)
    return beam_directions_of(optics, shape)


def _sees_nothing(layers: Layers, phasors: Float32Array, settings: UnmixSettings) -> BoolArray:
    """Pixels (row, col) without any surface: c_0 explains their samples, or too few samples are valid.

    A sum of the phasors of two surfaces may have a phase outside of the working range, as c_0 has. But it has more
    light than the dimmest surfaces, and open space has not.
    """
    amplitude, seen = np.hypot(phasors[..., 0], phasors[..., 1]), layers.n_modes > 0
    dim = float(np.quantile(amplitude[seen], settings.dimmest)) if seen.any() else math.inf
    empty = (layers.n_modes == 0) & (np.nan_to_num(layers.weight_no_return) > settings.open_share) & (amplitude <= dim)
    lost = layers.status == int(Status.TOO_FEW_SAMPLES)
    return np.asarray(empty | lost)


_RANGE_MM, _SIGMA_MM, _FREQUENCY_HZ = 1000.0, 10.0, 20.0e6
_FRAMES, _EDGE_SIDE = 20, 12
"""Range of the near surface, noise and frequency of the camera, and size of the image."""


def warm_up_curved() -> None:
    """Let rays meet a patch, as beside surfaces that bend."""
    frame = TangentFrame(*(np.eye(3)[[part]] for part in (2, 0, 1, 2)))
    meet(frame, np.zeros((1, 1, STATE)), np.eye(3)[np.newaxis, 2:])


def warm_up() -> None:
    """Unmix the pixels between two surfaces that share the middle column."""
    sensor = Sensor(
        name="warm-up",
        range_max_mm=2.0 * _RANGE_MM,
        fov_horizontal_deg=10.0,
        fov_vertical_deg=10.0,
        modulation_frequency_hz=_FREQUENCY_HZ,
        noise=NoiseCurve(np.array([_RANGE_MM]), np.array([_SIGMA_MM])),
    )
    share = np.repeat([1.0, 0.5, 0.0], [_EDGE_SIDE // 2, 1, _EDGE_SIDE // 2 - 1])
    scale = phase_scale_mm(_FREQUENCY_HZ)
    sums = share * np.exp(1j * _RANGE_MM / scale) + (1.0 - share) * np.exp(1.5j * _RANGE_MM / scale)
    shape = (_FRAMES, _EDGE_SIDE, _EDGE_SIDE)
    range_mm = np.random.default_rng(3).normal(scale * np.angle(sums), _SIGMA_MM, shape)
    light = np.random.default_rng(4).normal(np.abs(sums), 0.01, shape)
    layers = Layers.empty(shape[1:], 1, layer_fields(sensor))
    layers.n_modes[...], layers.status[...], layers.n_samples[...] = 1, int(Status.OK), _FRAMES
    layers.range[..., 0], layers.sigma[..., 0], layers.weight[..., 0] = np.median(range_mm, axis=0), _SIGMA_MM, 1.0
    layers.range_stderr[..., 0], layers.weight_stderr[..., 0] = _SIGMA_MM / np.sqrt(_FRAMES), 0.0
    unmix(layers, mean_phasors(range_mm, light, sensor), sensor, insist=True)
