"""A scene as a recording saw it: layers in place of rectangles, pixel by pixel, with the errors of what was seen.

Use `measured_scene` for the layers of a recording, and `camera_of` for the camera of a model of them. A `Model` with a
`MeasuredScene` is cast by `tofmix.simulation.casting.cast`: each layer keeps its share, and an effect that
places a surface moves the ranges of its layers along the beams. So everything after the cast is the same as for
rectangles.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.special import betaln

from tofmix.arrays import BoolArray, FloatArray
from tofmix.errors import BadInputError
from tofmix.layers import Layers
from tofmix.optics.projection import beam_directions_of
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.surface import MAX_LENGTH_MM, USUAL_REFLECTIVITY, Surface, surface_along

LEAST_SAMPLES = 8
"""Valid samples of a pixel, at least, from which its layers are taken as its distribution."""

OWN_ERROR = 0.02
"""Error of every mean, in sigma, beside that of chance: no scene and no camera stays the same to better than this."""

WALKS = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Sizes of a walk of all means: standard deviation of the way from the first to the last tenth of the recording's time,
in sigma."""

NONE_LOST = 0.5
"""Lost samples of an image that lost none: the mean of Jeffreys' prior."""

UNKNOWN_WALK = (0.5, 0.1, 0.1, 0.1, 0.1, 0.1)
"""Their probabilities where no recording tells them."""

USUAL_SPREAD = 0.25
"""Standard deviation of the logarithm of the widths of pixels where the recording was too short to show any: those of
real cameras are 0.2 to 0.4."""

_ONE_ZONE_DEG = 25.0  # field of view of a sensor of one zone that does not give its own


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneTable:
    """What the table ``[scene]`` of a model says of its layers, beside the window.

    Parameters
    ----------
    frame_noise : float
        Standard deviation of what all samples of a frame have in common, in sigma.
    walks : tuple of float
        Probability of each of `WALKS`; empty where nothing tells them.
    range_max_mm : float
        Longest range of any recording of the scene, of a camera that does not say its own; 0 is that of the layers.
    every : int
        Frames from one sample to the next: a camera that filters its ranges over time repeats itself in between.
    way_mm : float
        How far ranges went straight within the recording; this way is no part of the layers. 0 if none was taken out.
    layers_path, surfaces_path : str
        Files, relative to the model; surfaces may be empty.
    """

    frame_noise: float = 0.0
    walks: tuple[float, ...] = ()
    range_max_mm: float = 0.0
    every: int = 1
    way_mm: float = 0.0
    layers_path: str = ""
    surfaces_path: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredScene(SceneTable):
    """What a recording saw. Arrays (row, col, layer) run from near to far and are NaN past a pixel's layers.

    Parameters
    ----------
    range_mm : (row, col, layer) float64
        Mean range of each layer.
    share : (row, col, layer) float64
        Share of the samples that are of the scene; with `no_return`, those of a pixel sum to 1.
    no_return : (row, col) float64
        Share of the samples without a surface.
    amplitude : (row, col, layer) float64 or None
        Mean amplitude; None if the recording has no amplitudes.
    width : (row, col, layer) float64
        Factor on sigma(r) of the camera.
    lost : (row, col) float64
        Share of the frames without a valid sample.
    lost_worth : float
        Frames that the image's mean share of lost samples is worth in each pixel.
    surface : (row, col, layer) int16
        Number of the layer's surface; `len(surfaces)` for a layer that is of none, -1 past the layers.
    surfaces : tuple of Surface
        The plane of each surface, as it was seen: its rectangle is as large as what was seen of it.
    frames : int
        Frames of the window.
    samples : (row, col) int64
        Valid samples of each pixel.
    range_error_mm : (row, col, layer) float64
        Standard error of each mean, of independent samples.
    width_spread : float
        Standard deviation of the logarithm of pixels' own widths, the prior of `width`.
    recorded_spread : float
        The same as the estimate found it; 0 if it found pixels alike.
    memory : float
        Correlation of the noise of a pixel from one frame to the next.
    """

    range_mm: FloatArray
    share: FloatArray
    no_return: FloatArray
    amplitude: FloatArray | None
    width: FloatArray
    lost: FloatArray
    surface: NDArray[np.int16]
    surfaces: tuple[Surface, ...]
    frames: int
    samples: NDArray[np.int64]
    range_error_mm: FloatArray
    width_spread: float = USUAL_SPREAD
    recorded_spread: float = 0.0
    memory: float = 0.0
    lost_worth: float = 0.0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.no_return.shape
        return rows, cols

    @property
    def known(self) -> BoolArray:
        """Pixels (row, col) of which the recording tells where their samples lie."""
        told = np.nan_to_num(self.share).sum(axis=2) + self.no_return > 0
        return np.asarray((self.samples >= LEAST_SAMPLES) & told)

    @property
    def beside_others(self) -> BoolArray:
        """Pixels (row, col) one of whose eight neighbours sees a surface, or nothing, that they do not see.

        A small share of that surface may be in the pixel: n samples tell shares to 1 / n, and a sample of the other
        surface lies many sigma away.
        """
        seen = np.zeros((*self.shape, len(self.surfaces) + 2), dtype=np.bool_)
        row, col, layer = np.nonzero(self.surface >= 0)
        seen[row, col, self.surface[row, col, layer]] = True
        seen[..., -1] = self.no_return > 0
        around = maximum_filter(seen, size=(3, 3, 1), mode="nearest")
        return np.asarray((around & ~seen).any(axis=2))

    def compared(self) -> "MeasuredScene":
        """The scene without samples in pixels that may see more than it knows: with these, it is not compared."""
        return replace(self, lost=np.where(self.known & ~self.beside_others, self.lost, 1.0))

    @property
    def repeats(self) -> float:
        """V = (1 + rho) / (1 - rho): frames that are worth one independent frame, in a mean over many."""
        return (1.0 + self.memory) / (1.0 - self.memory)

    @property
    def main(self) -> NDArray[np.int64]:
        """The layer (row, col) of the largest share."""
        return np.asarray(np.nan_to_num(self.share, nan=-1.0).argmax(axis=2))

    def of_main(self, values: FloatArray) -> FloatArray:
        """Values (row, col, layer) of the layer of the largest share, (row, col)."""
        return np.asarray(np.take_along_axis(values, self.main[:, :, None], axis=2)[:, :, 0])

    def mean_variance(self) -> FloatArray:
        """Variance (row, col) of the mean of a pixel's samples, in units of its sigma squared; infinite if not known.

        s^2 v / n and the error that no number of samples lowers; s is a layer's sigma.
        """
        count = np.where(self.known, self.samples, 0)
        with np.errstate(divide="ignore"):
            return np.asarray(self.repeats / count + OWN_ERROR**2)

    def frame_variance(self) -> float:
        """Variance of the mean of all samples by the noise that the samples of a frame share, in sigma squared."""
        return self.repeats * self.frame_noise**2 / max(self.frames, 1)

    @property
    def middle_error_mm(self) -> float:
        """Standard error of all means together by the way that was taken out: no way is quite straight."""
        uneven = 0.05  # part of a way by which its middle is off
        return uneven * abs(self.way_mm)

    def common_width_error(self) -> float:
        """Standard error of the logarithm of all widths together: by chance, the memory of the noise, and the camera.

        The variance about a mean of n samples is too small by v / n. Squares of AR(1) noise have the memory rho^2.
        """
        squares = (1.0 + self.memory**2) / (1.0 - self.memory**2)
        known = max(int(np.where(self.known, self.samples, 0).sum()), 1)
        by_memory = 0.5 * (self.repeats - 1.0) / max(self.frames, 1)
        of_camera = 0.006  # no noise stays the same to better than this
        uneven = 0.02  # part of a way that is not straight, and is left in the noise
        by_way = 0.5 * np.log1p((uneven * self.way_mm / self.typical_sigma_mm) ** 2) if self.way_mm else 0.0
        return float(np.sqrt(squares / (2.0 * known) + by_memory**2 + of_camera**2 + by_way**2))

    @property
    def typical_sigma_mm(self) -> float:
        """Standard deviation of a sample of a typical layer."""
        each = self.range_error_mm * np.sqrt(np.maximum(self.samples, 1))[..., None]
        return float(np.nanmedian(each)) if np.isfinite(each).any() else 1.0

    def width_error(self) -> FloatArray:
        """Standard error (row, col) of the logarithm of a pixel's width, estimated from its samples.

        The posterior of a width with a normal prior of its logarithm; n samples have the information 2 n.
        """
        return np.asarray(1.0 / np.sqrt(self.width_spread**-2 + self._told_of_width()))

    def _told_of_width(self) -> FloatArray:
        """Information (row, col) of a pixel's samples about the logarithm of its width."""
        return np.asarray(2.0 * np.where(self.known, self.samples, 0) / self.repeats)

    def lent_log_width(self) -> FloatArray:
        """Error (row, col) of the logarithm of a width that the pixels of a surface share: what the curve lent them.

        Few samples leave a width near that of the curve. If all pixels of a surface are wider, as on a slope, all of
        them are drawn to the curve, by what their mean tells. 0 for a layer of no surface.
        """
        told = self._told_of_width()
        kept = told / (told + self.width_spread**-2)
        with np.errstate(divide="ignore", invalid="ignore"):
            width = np.nan_to_num(np.log(self.of_main(self.width)), nan=0.0, posinf=0.0, neginf=0.0)
        own, out = self.of_main(self.surface.astype(np.float64)), np.zeros(width.shape)
        for number in range(len(self.surfaces)):
            some = self.known & (own == number) & (kept > 0)
            if some.any():
                out[some] = (1.0 - kept[some]) * width[some].sum() / kept[some].sum()
        return out


SceneParts = tuple[CompleteCamera, MeasuredScene]
"""The camera and the scene of a recording."""


def camera_of(
    sensor: Sensor, shape: tuple[int, int], *, longest_mm: float, others_mm: float = 0.0
) -> tuple[CompleteCamera, list[str]]:
    """The camera of a model of what a sensor saw, and what was assumed of it.

    Parameters
    ----------
    sensor : Sensor
        With a noise curve; its background density is not kept.
    shape : (int, int)
        Rows and columns.
    longest_mm : float
        The longest range that was seen, in place of an unknown `range_max_mm`.
    others_mm : float
        The same of other recordings of this camera.

    Raises
    ------
    ValueError
        If there is no noise curve, or a number is outside its bounds. The message begins with a key.
    """
    if sensor.noise is None:
        raise ValueError("no noise curve; estimate the recording with --noise auto")
    notes = []
    curve: NoiseCurve = replace(sensor.noise, background_density=None)
    tau, far, near = sensor.integration_time_ms, sensor.range_max_mm, sensor.range_min_mm
    if tau is None:
        tau = 1.0
        notes.append("integration_time_ms is not known: 1 is written, for which the noise holds")
    if far is None:
        far = max(sensor.sample_max_mm or float(np.ceil(longest_mm)), float(np.ceil(others_mm)))
        notes.append(f"range_max_mm is not known: {far:g} is written, the longest range that was seen")
    by_angles = sensor.projection is None
    wide, high = (sensor.fov_horizontal_deg, sensor.fov_vertical_deg) if by_angles else (None, None)
    if by_angles and (wide is None or high is None) and shape == (1, 1):
        wide = high = _ONE_ZONE_DEG
        notes.append(f"the field of view of the one pixel is not known: {_ONE_ZONE_DEG:g} degrees are written")
    exponent = 0.5  # of the law of the integration time, by counting photons: one recording does not tell it
    camera = CompleteCamera(
        name=sensor.name,
        rows=shape[0],
        cols=shape[1],
        fov_horizontal_deg=wide,
        fov_vertical_deg=high,
        projection=sensor.projection,
        measurement=sensor.measurement,
        range_min_mm=max(near or 0.0, 0.0),
        range_max_mm=far,
        integration_time_ms=tau,
        default_integration_time_ms=tau,
        noise=curve,
        reference_integration_time_ms=tau,
        exponent=exponent,
        modulation_frequency_hz=sensor.modulation_frequency_hz,
        outlier_probability=sensor.outlier_probability,
    )
    return camera, notes


def measured_scene(
    layers: Layers,
    sensor: Sensor,
    surface: NDArray[np.integer],
    *,
    frames: int,
    table: SceneTable | None = None,
) -> SceneParts:
    """The scene of a window's layers, with its camera.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    sensor : Sensor
        The camera with the noise of the estimate.
    surface : (row, col, layer) int
        Number of the surface of each layer; -1 for none.
    frames : int
        Frames of the window.
    table : SceneTable, optional
        Of the model; its defaults without it.

    Raises
    ------
    ValueError
        If the noise or the directions of pixels are not known. The message begins with a key.
    BadInputError
        If no pixel has a layer.
    """
    table, there = table or SceneTable(), np.isfinite(layers.range)
    if not there.any():
        raise BadInputError("no pixel has a layer, so there is no scene")
    rows, cols = layers.n_modes.shape
    seen = slice(1 + int(np.flatnonzero(there.any(axis=(0, 1)))[-1]))  # files have room for more layers than are there
    there, surface = there[:, :, seen], surface[:, :, seen]
    longest = float(np.nanmax(layers.range))
    camera, _ = camera_of(sensor, (rows, cols), longest_mm=longest, others_mm=table.range_max_mm)
    spread = camera.noise.width_spread
    camera = replace(camera, noise=replace(camera.noise, width_spread=0.0))  # a measured scene has the widths
    range_mm = layers.range[:, :, seen].astype(np.float64)
    amplitude = None if layers.amplitude is None else _filled(layers.amplitude[:, :, seen].astype(np.float64), there)
    curve = camera.noise.sigma(np.nan_to_num(range_mm, nan=1.0), amplitude)
    weight = np.where(there, np.nan_to_num(layers.weight[:, :, seen].astype(np.float64)), 0.0)
    nothing = np.nan_to_num(layers.weight_no_return.astype(np.float64))
    whole = weight.sum(axis=2) + nothing
    whole = np.where(whole > 0, whole, 1.0)
    samples = layers.n_samples.astype(np.int64)
    lost = np.zeros((rows, cols)) if layers.invalid_share is None else layers.invalid_share.astype(np.float64)
    told = (weight.sum(axis=2) + nothing > 0) & (samples >= LEAST_SAMPLES)
    usual, worth = _usual_loss(np.where(np.isfinite(lost), lost, 0.0)[told], frames)
    lost = (np.where(np.isfinite(lost), lost, 0.0) * frames + worth * usual) / (frames + worth)
    lost = np.where(told, lost, 1.0)  # of other pixels nothing is known, and no sample is predicted
    own, planes = _planes(range_mm, there, surface, camera)
    scene = MeasuredScene(
        range_mm=range_mm,
        share=np.where(there, weight / whole[:, :, None], np.nan),
        no_return=nothing / whole,
        amplitude=amplitude,
        width=np.where(there, layers.sigma[:, :, seen].astype(np.float64) / curve, np.nan),
        lost=lost,
        lost_worth=worth,
        surface=own,
        surfaces=planes,
        frames=frames,
        samples=samples,
        range_error_mm=layers.range_stderr[:, :, seen].astype(np.float64),
        width_spread=spread or USUAL_SPREAD,
        recorded_spread=spread,
        memory=0.0 if sensor.learnt is None else sensor.learnt.memory,
        frame_noise=table.frame_noise,
        walks=table.walks,
        range_max_mm=table.range_max_mm,
        every=table.every,
        way_mm=table.way_mm,
        layers_path=table.layers_path,
        surfaces_path=table.surfaces_path,
    )
    return camera, _with_mean_widths(scene)


def _with_mean_widths(scene: MeasuredScene) -> MeasuredScene:
    """The scene with the posterior means of the logarithms of widths; those of its layers are the most likely ones.

    The mean of n samples takes one degree of freedom of their variance, and the logarithm of a chi-square of n - 1 is
    1 / (n - 1) below that of its mean on average: together 1 / n of sigma. With a prior it is less, by as much as the
    variance of the logarithm, 1 / 2 n without one. Widths that are all alike are those of the curve.
    """
    if not scene.recorded_spread:
        return scene
    return replace(scene, width=scene.width * np.exp(2.0 * scene.width_error() ** 2)[:, :, None])


def _usual_loss(lost: FloatArray, frames: int) -> tuple[float, float]:
    """The mean share of lost samples, and the frames that it is worth in each pixel.

    Shares of pixels are Beta(w p, w (1 - p)) about the mean p, so counts are beta-binomial. The image has one share, or
    one that differs as little as counts allow: w is the largest that they do not contradict. Where 60 frames of each
    pixel lose nothing, a small w would say that hardly any pixel ever loses a sample.

    Parameters
    ----------
    lost : (pixel,) float64
        Share of each pixel.
    frames : int
        Frames.

    References
    ----------
    Skellam, J. R. Statist. Soc. B 10 (1948) 257.
    """
    count, samples = np.rint(lost * frames), max(frames * lost.size, 1)
    mean, worth = float(count.sum()) / samples, 0.5 * 4.0 ** np.arange(12)
    a, b = worth * max(mean, NONE_LOST / samples), worth * max(1.0 - mean, NONE_LOST / samples)
    nats = betaln(count[:, None] + a, frames - count[:, None] + b).sum(axis=0) - lost.size * betaln(a, b)
    contradicted = 2.0  # nats below the most likely one
    return mean, float(worth[nats >= nats.max() - contradicted][-1])


def _filled(amplitude: FloatArray, there: BoolArray) -> FloatArray | None:
    """Amplitudes with the median in place of those that are not known (of phasor sums); None if none is known."""
    known = np.isfinite(amplitude) & (amplitude > 0)
    if not known.any():
        return None
    return np.where(there, np.where(known, amplitude, float(np.median(amplitude[known]))), np.nan)


def _planes(
    range_mm: FloatArray,
    there: BoolArray,
    surface: NDArray[np.integer],
    camera: CompleteCamera,
) -> tuple[NDArray[np.int16], tuple[Surface, ...]]:
    """Numbers (row, col, layer) of surfaces, and the plane of each; those of too few layers are none.

    Smooth surfaces that are no planes have the plane through their points: effects move them along its normal. A
    sensor of one pixel sees each of its layers as a plane that faces it.
    """
    beams = beam_directions_of(camera.optics, camera.shape)
    found: list[Surface] = []
    own = np.where(there, -2, -1).astype(np.int64)
    if camera.shape == (1, 1):
        for k in np.flatnonzero(there[0, 0]).tolist():
            place = beams[0, 0] * range_mm[0, 0, k]
            half = range_mm[0, 0, k] * np.tan(np.radians(_ONE_ZONE_DEG / 2))
            found.append(_plane(len(found), place[None], beams[0, 0], np.full(2, max(2 * half, 1.0))))
            own[0, 0, k] = len(found) - 1
    for number in np.unique(surface[there & (surface >= 0)]).tolist():
        row, col, seen = np.nonzero(there & (surface == number))
        points = beams[row, col] * range_mm[row, col, seen][:, None]
        normal = _normal(beams[row, col], range_mm[row, col, seen])
        if normal is None or len(found) >= np.iinfo(np.int16).max - 1:
            continue
        own[row, col, seen] = len(found)
        found.append(_plane(number, points, normal, None))
    own[own == -2] = len(found)  # noqa: PLR2004  layers that are of no surface
    return own.astype(np.int16), tuple(found)


def _normal(beams: FloatArray, range_mm: FloatArray) -> FloatArray | None:
    """Unit normal of the plane of layers: 1 / r = m . d by least squares, each by its relative error."""
    plane_points = 3  # that a plane needs
    if len(range_mm) < plane_points:
        return None
    inverse = np.linalg.lstsq(beams * range_mm[:, None], np.ones(len(range_mm)), rcond=None)[0]
    length = float(np.linalg.norm(inverse))
    least_normal = 1e-9  # length of a normal that is none
    normal = inverse / max(length, least_normal)
    seen = beams @ normal
    return np.asarray(normal, dtype=np.float64) if length > least_normal and (seen > 0).all() else None


def _plane(number: int, points: FloatArray, normal: FloatArray, size_mm: FloatArray | None) -> Surface:
    """A surface of this number, as large as the points seen of it."""
    along = float((points @ normal).mean())
    upright = np.array([0.0, 1.0, 0.0]) if abs(normal[1]) < abs(normal[2]) else np.array([0.0, 0.0, 1.0])
    across = np.cross(upright, normal)
    u = across / np.linalg.norm(across)
    v = np.cross(normal, u)
    spans = np.stack([points @ u, points @ v], axis=1)
    low, high = spans.min(axis=0), spans.max(axis=0)
    middle = (low + high) / 2
    size = np.clip(high - low, 1.0, MAX_LENGTH_MM) if size_mm is None else size_mm
    return surface_along(
        f"surface {number}",
        center_mm=along * normal + middle[0] * u + middle[1] * v,
        size_mm=size,
        axes=np.stack([u, v, normal], axis=1),
        reflectivity=USUAL_REFLECTIVITY,
    )


def scene_words(scene: MeasuredScene) -> str:
    """The scene in words."""
    names = [f'"{surface.name}"' for surface in scene.surfaces]
    layers, free = int((scene.surface >= 0).sum()), int((scene.surface == len(scene.surfaces)).sum())
    of = f", {free:,} of them of no surface" if free else ""
    return f"{layers:,} layers of {scene.layers_path or 'a recording'}{of}; surfaces: {', '.join(names) or 'none'}"
