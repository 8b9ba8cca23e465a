"""Edges below a pixel: recordings of scenes of `plates`, and judges of what is found in them.

Layers are the estimator's own (`recorded`, `drawn`, `estimated`), or made from the truth with the scatter of counts
alone (`counted`): quick, and without what an estimator does.
"""

from dataclasses import dataclass

import numpy as np
from blind.camera import Device
from blind.geometry import Surface, View

from support.counts import counted_layers
from support.lock_in import made, sensor_of
from support.plates import FULL, PARTS, Plate, Scene, scene
from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.settings import EstimateOptions
from tofmix.flags import mixing_name
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor

NOTHING = -1
"""Number of no surface in the truth."""

LEAST_SHARE = 0.05
"""Least share of the second surface of a pixel that counts as mixed."""

LEAST_GAP = 0.03
"""Least distance of its surfaces, as a share of the range."""

LEAST_GAP_STDERR = 5.0
"""And in standard errors of the mean of all frames."""

LEAST_LAYERS = 12
"""Layers of a true surface whose completeness counts."""

DEVICE = Device(name="lock-in")
SCALE_MM = DEVICE.unambiguous_mm / (2 * np.pi)


def camera(view: View = FULL) -> Sensor:
    """The camera of all scenes."""
    return sensor_of(DEVICE, (view.fov_horizontal_deg, view.fov_vertical_deg))


def recorded(
    surfaces: list[Surface], seed: int, *, view: View = FULL, frames: int, q: float
) -> tuple[Scene, ArrayRecording]:
    """Record rectangles with the raw-tap simulator of tests/blind, and cast them on our own."""
    size = view.rows, view.cols, view.fov_horizontal_deg, view.fov_vertical_deg
    raw = made(surfaces, seed, view=size, frames=frames, q=q)
    return scene([Plate.of(surface) for surface in surfaces], view), raw.recording


def drawn(one: Scene, frames: int, seed: int, *, q: float = 0.0) -> ArrayRecording:
    """Draw a recording: a sample is of one surface by area share, or with the chance `q` the phasor sum of all.

    Amplitudes fall with the square of the range and the cosine of incidence. The noise of a phasor is the same along
    and across it, sigma(r) of its range; random values come as often as the sensor says. Every pixel must see plates
    alone.
    """
    rng = np.random.default_rng([seed, 5])
    truth, view = one.truth, one.view
    flat = truth.share.reshape(len(one.plates), -1)
    ranges = np.nan_to_num(truth.range_mm.reshape(flat.shape), nan=1000.0)
    gloss = truth.cosine.reshape(flat.shape) * np.array([plate.reflectivity for plate in one.plates])[:, np.newaxis]
    amplitude = 1000.0 * gloss * (1000.0 / ranges) ** 2
    sigma = amplitude * DEVICE.design_sigma(ranges) / SCALE_MM
    first = flat.argmax(axis=0)
    at = np.arange(flat.shape[1])
    z = np.broadcast_to(_phasor(amplitude, ranges)[first, at], (frames, len(at))).copy()
    noise = np.broadcast_to(sigma[first, at], z.shape).copy()
    several = np.flatnonzero(flat.max(axis=0) < 1.0)
    upto = np.cumsum(flat[:, several], axis=0)
    upto /= upto[-1]
    lot = rng.random((frames, len(several)))
    which = np.zeros(lot.shape, dtype=np.int64)
    for bound in upto[:-1]:
        which += lot >= bound
    z[:, several] = _phasor(amplitude, ranges)[which, several]
    noise[:, several] = sigma[which, several]
    summed = rng.random(lot.shape) < q
    total = (flat * _phasor(amplitude, ranges))[:, several].sum(axis=0)
    spread = np.sqrt((flat * sigma**2)[:, several].sum(axis=0))
    z[:, several] = np.where(summed, total, z[:, several])
    noise[:, several] = np.where(summed, spread, noise[:, several])
    z += noise * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    found = SCALE_MM * np.mod(np.angle(z), 2 * np.pi)
    found[found > DEVICE.range_max_mm] = np.nan
    random = rng.random(found.shape) < DEVICE.outlier_probability
    found[random] = rng.uniform(DEVICE.range_min_mm, DEVICE.range_max_mm, int(random.sum()))
    size = frames, view.rows, view.cols
    light = np.abs(z).reshape(size) if q > 0 else None
    return ArrayRecording(found.reshape(size), camera(view), amplitude=light)


def _phasor(amplitude: FloatArray, range_mm: FloatArray) -> np.ndarray:
    return np.asarray(amplitude * np.exp(1j * range_mm / SCALE_MM))


def first_frames(recording: ArrayRecording, frames: int) -> ArrayRecording:
    """The beginning of a recording: frames are independent of each other."""
    rows = slice(0, recording.shape[1])
    light = recording.read_amplitude(slice(0, frames), rows) if recording.has_amplitude else None
    return ArrayRecording(recording.read_range(slice(0, frames), rows), recording.sensor, amplitude=light)


def estimated(recording: ArrayRecording, options: EstimateOptions | None = None) -> Layers:
    """The estimator's layers (row, col), all defaults, one core."""
    found = estimate_layers(recording, options)
    return Layers(**{spec.name: getattr(found, spec.name)[0] for spec in found.fields})


def counted(one: Scene, frames: int, seed: int, *, max_layers: int = 6) -> Layers:
    """Layers as an estimator would find them that knows the surface of each sample: counts and means of them."""
    rng = np.random.default_rng([seed, 6])
    truth = one.truth
    nothing = np.maximum(0.0, 1.0 - truth.share.sum(axis=0))
    return counted_layers(
        truth.share, truth.range_mm, nothing, DEVICE.design_sigma, samples=frames, rng=rng, most=max_layers
    )


@dataclass(slots=True, kw_only=True)
class Wrong:
    """Parts of mixed pixels: how many got another surface than they see, and how many of these none at all."""

    pixels: int = 0
    share_sum: float = 0.0
    none_sum: float = 0.0

    def __add__(self, other: "Wrong") -> "Wrong":
        return Wrong(**{name: getattr(self, name) + getattr(other, name) for name in self.__slots__})

    @property
    def mean(self) -> float:
        """Share of the parts, mean over pixels; NaN without one."""
        return self.share_sum / self.pixels if self.pixels else float("nan")

    @property
    def none(self) -> float:
        """Share of the parts that are wrong as they have no range; NaN without a pixel."""
        return self.none_sum / self.pixels if self.pixels else float("nan")


def mixed(one: Scene, frames: int, *, surfaces: int = 2) -> BoolArray:
    """Pixels (row, col) that see several surfaces far enough apart, `surfaces` of them with shares that count."""
    truth = one.truth
    nothing = 1.0 - truth.share.sum(axis=0)
    counts = (truth.share >= LEAST_SHARE).sum(axis=0) + (nothing >= LEAST_SHARE)
    ranges = np.sort(np.where(truth.share > 0, truth.range_mm, np.inf), axis=0)
    near, far = ranges[:-1], ranges[1:]
    both = np.isfinite(far)
    near, far = np.where(both, near, 1.0), np.where(both, far, np.inf)
    error = np.where(both, np.hypot(DEVICE.design_sigma(near), DEVICE.design_sigma(np.where(both, far, 1.0))), 0.0)
    apart = (far - near > LEAST_GAP * near) & (far - near > LEAST_GAP_STDERR * error / np.sqrt(frames))
    return np.asarray((counts >= surfaces) & apart.all(axis=0))


def by_parts(image: np.ndarray, pixels: BoolArray) -> np.ndarray:
    """Parts (pixel, 64) of the pixels that are asked for, of an image of parts."""
    rows, cols = pixels.shape
    return np.asarray(image.reshape(rows, PARTS, cols, PARTS).transpose(0, 2, 1, 3)[pixels].reshape(-1, PARTS**2))


def wrong_parts(one: Scene, range_fine: np.ndarray, frames: int, *, surfaces: int = 2) -> FloatArray:
    """Share (row, col) of each mixed pixel's parts with the wrong surface; NaN where a pixel is none.

    A part has the surface of its pixel whose true range is nearest to `range_fine`, and none where that is NaN.
    """
    pixels = mixed(one, frames, surfaces=surfaces)
    found = by_parts(range_fine, pixels).astype(float)
    true = one.truth.range_mm[:, pixels].T
    off = np.abs(found[:, :, np.newaxis] - true[:, np.newaxis, :])
    label = np.where(np.isnan(found), NOTHING, np.where(np.isnan(off), np.inf, off).argmin(axis=-1))
    out = np.full(pixels.shape, np.nan)
    out[pixels] = (label != by_parts(one.truth.part_surface, pixels)).mean(axis=1)
    return out


def judge_parts(one: Scene, range_fine: np.ndarray, frames: int, *, surfaces: int = 2) -> Wrong:
    """Mean of `wrong_parts` over all mixed pixels."""
    shares = wrong_parts(one, range_fine, frames, surfaces=surfaces)
    there = ~np.isnan(shares)
    none = np.isnan(by_parts(range_fine, there)) & (by_parts(one.truth.part_surface, there) != NOTHING)
    return Wrong(pixels=int(there.sum()), share_sum=float(shares[there].sum()), none_sum=float(none.sum()) / PARTS**2)


def worst_pixels(one: Scene, layers: Layers, shares: FloatArray, count: int) -> list[str]:
    """Name the pixels (row, col) with the most wrong parts, and say what is true and what was estimated."""
    ranked = np.argsort(np.nan_to_num(shares, nan=-1.0), axis=None, kind="stable")[::-1][:count]
    out = []
    for row, col in zip(*np.unravel_index(ranked, shares.shape), strict=True):
        seen = np.flatnonzero(one.truth.share[:, row, col] > 0)
        true = ", ".join(f"{one.truth.share[k, row, col]:.3f} at {one.truth.range_mm[k, row, col]:.0f}" for k in seen)
        found = range(int(layers.n_modes[row, col]))
        ours = ", ".join(f"{layers.weight[row, col, k]:.3f} at {layers.range[row, col, k]:.0f}" for k in found)
        law = "" if layers.mixing is None else f"; {mixing_name(int(layers.mixing[row, col]))}"
        out.append(f"pixel {row}, {col}: {shares[row, col]:.2f} wrong; true {true}; layers {ours}{law}")
    return out


def matched(one: Scene, layers: Layers, *, any_distance: bool = False) -> IntArray:
    """Number (row, col, layer) of the true surface of its pixel that each layer is nearest to; -1: no layer.

    Also -1 where none is within 5 standard errors or 1 % of its range, unless `any_distance`.
    """
    true = np.moveaxis(one.truth.range_mm, 0, -1)[:, :, np.newaxis, :]
    ranges = layers.range.astype(float)
    off = np.abs(ranges[..., np.newaxis] - true)
    off = np.where(np.isnan(off), np.inf, off)
    best = off.min(axis=-1)
    reach = np.maximum(5.0 * layers.range_stderr, 0.01 * ranges)
    there = np.arange(layers.max_layers) < layers.n_modes[..., np.newaxis]
    near = np.isfinite(best) if any_distance else best <= np.where(np.isnan(reach), 0.0, reach)
    return np.where(there & near, off.argmin(axis=-1), NOTHING)


@dataclass(slots=True, kw_only=True)
class Links:
    """Layers that are linked with others of their own surface, and surfaces whose layers are linked."""

    linked: int = 0
    own: int = 0
    visible: int = 0
    in_largest: int = 0
    surfaces: int = 0
    true_surfaces: int = 0

    def __add__(self, other: "Links") -> "Links":
        return Links(**{name: getattr(self, name) + getattr(other, name) for name in self.__slots__})

    @property
    def purity(self) -> float:
        """Share of linked layers whose linked surface is mostly of their own true surface."""
        return self.own / self.linked if self.linked else float("nan")

    @property
    def completeness(self) -> float:
        """Share of the layers of true surfaces that are in the largest linked part of theirs."""
        return self.in_largest / self.visible if self.visible else float("nan")


def judge_links(one: Scene, layers: Layers, surface: np.ndarray) -> Links:
    """Hold linked surfaces (row, col, layer) against the truth; layers without a true surface do not count."""
    true = matched(one, layers)
    table = _table(one, true, surface)
    sizes = np.bincount(true[true >= 0], minlength=len(one.plates))
    asked = sizes >= LEAST_LAYERS
    largest = table.max(axis=0, initial=0)
    return Links(
        linked=int(table.sum()),
        own=int(table.max(axis=1, initial=0).sum()),
        visible=int(sizes[asked].sum()),
        in_largest=int(largest[asked].sum()),
        surfaces=int((table.sum(axis=1) > 0).sum()),
        true_surfaces=int(asked.sum()),
    )


def _table(one: Scene, true: IntArray, surface: np.ndarray) -> IntArray:
    """Layers (linked surface, plate) of each linked and each true surface."""
    both = (true >= 0) & (surface >= 0)
    found, count = int(surface.max(initial=-1)) + 1, len(one.plates)
    return np.bincount(surface[both] * count + true[both], minlength=found * count).reshape(found, count)


def between(
    one: Scene,
    layers: Layers,
    surface: np.ndarray,
    near: np.ndarray,
    far: np.ndarray,
    *,
    plates: tuple[int, int] = (0, 1),
) -> BoolArray:
    """Whether points of edges (point,) are between the linked surfaces that are mostly of two plates."""
    table = _table(one, matched(one, layers), surface)
    mostly = np.append(np.where(table.sum(axis=1) > 0, table.argmax(axis=1), NOTHING), NOTHING)
    return np.asarray((mostly[near] == plates[0]) & (mostly[far] == plates[1]))


@dataclass(slots=True, kw_only=True)
class Places:
    """Points of an edge against the true one; `elsewhere` are points of edges that are none."""

    points: int = 0
    elsewhere: int = 0
    squares: float = 0.0
    z_squares: float = 0.0
    far_off: int = 0
    pixels: int = 0
    with_point: int = 0

    def __add__(self, other: "Places") -> "Places":
        return Places(**{name: getattr(self, name) + getattr(other, name) for name in self.__slots__})

    @property
    def rms(self) -> float:
        """Root mean square distance, pixels."""
        return float(np.sqrt(self.squares / self.points)) if self.points else float("nan")

    @property
    def z_rms(self) -> float:
        """Root mean square distance in standard errors; 1: they are right."""
        return float(np.sqrt(self.z_squares / self.points)) if self.points else float("nan")

    @property
    def covered(self) -> float:
        """Share of the mixed pixels that have a point."""
        return self.with_point / self.pixels if self.pixels else float("nan")


def judge_places(
    one: Scene, frames: int, row: np.ndarray, col: np.ndarray, stderr: np.ndarray | None = None, *, elsewhere: int = 0
) -> Places:
    """Hold points of edges against the edge of a half-plane, plate 0; those above 0.25 pixels off are counted, too."""
    off = one.plates[0].edge_distance(one.view, row.astype(float), col.astype(float))
    pixels = mixed(one, frames)
    touched = np.zeros(pixels.shape, dtype=bool)
    down, across = np.rint(row).astype(int), np.rint(col).astype(int)
    inside = (down >= 0) & (down < pixels.shape[0]) & (across >= 0) & (across < pixels.shape[1])
    touched[down[inside], across[inside]] = True
    z = off / stderr if stderr is not None else np.full(off.shape, np.nan)
    return Places(
        points=len(off),
        elsewhere=elsewhere,
        squares=float((off**2).sum()),
        z_squares=float((z**2).sum()),
        far_off=int((np.abs(off) > 0.25).sum()),
        pixels=int(pixels.sum()),
        with_point=int((touched & pixels).sum()),
    )
