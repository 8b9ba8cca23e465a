"""Effects that are in no list: what a camera may do that the effect kinds do not know.

For each, `axes` names the axes of a reconciliation's `where` on which such a disagreement may rightly be located. Sizes
are in units of the local sigma, so that each is as plain on a near board as on a far wall.
"""

import math

import numpy as np

from blind.camera import Exposure, Mechanism
from blind.geometry import Array


class Stranger(Mechanism):
    """Something that no effect kind describes, of a size in sigma."""

    axes: tuple[str, ...] = ()
    about = ""

    def __init__(self, size: float, seed: int) -> None:
        self.size = size
        self.seed = seed

    def rng(self) -> np.random.Generator:
        """What is fixed for the device."""
        return np.random.default_rng([self.seed, 61])


MISSING_OBJECT = "missing_object"  # a board that the model lacks: of the scene, not of the camera (`blind.scenes`)
MISSING_OBJECT_AXES = ("surface", "row", "col", "radius", "range")


def _sigma(x: Exposure) -> Array:
    sigma: Array = x.device.design_sigma(np.where(x.empty, x.device.range_max_mm, x.true_mm)).astype(np.float32)
    return sigma


class MainsRipple(Stranger):
    """Lamps at 100 Hz under a rolling read-out: a wave of delay that runs over the rows, another in each frame."""

    axes = ("row", "frame", "time")

    def clock(self, x: Exposure) -> None:
        rows = np.repeat(np.arange(x.device.rows), x.device.cols)
        when = x.time_s[:, None] + rows * (0.7 / x.device.frame_rate_hz / x.device.rows)
        hertz = 100.0 + self.rng().uniform(0.3, 0.9)
        x.delay(self.size * math.sqrt(2) * np.sin(2 * np.pi * hertz * when) * _sigma(x))


class Tripod(Stranger):
    """A camera that swings to and fro along its axis."""

    axes = ("frame", "time")

    def clock(self, x: Exposure) -> None:
        hertz = x.device.frame_rate_hz * self.rng().uniform(0.11, 0.19)
        azimuth, elevation = x.device.view.angles()
        swing = np.sin(2 * np.pi * hertz * x.time_s)[:, None] * (np.cos(azimuth) * np.cos(elevation))
        x.delay(self.size * math.sqrt(2) * float(np.median(_sigma(x))) * swing)


class SkewedTail(Stranger):
    """Light that comes late, the more the farther: an exponential tail towards far."""

    axes = ("range", "surface", "amplitude", "all")

    def clock(self, x: Exposure) -> None:
        tail = x.rng.standard_exponential(x.z.shape, np.float32) - 1
        x.delay(self.size * tail * _sigma(x) * (x.true_mm / np.float32(4000.0)))


class HeavyTails(Stranger):
    """Noise like Student's t with three degrees of freedom, of the same spread."""

    axes = ("all", "range", "surface", "row", "col", "frame", "amplitude")

    def word(self, x: Exposure, range_mm: Array, amplitude: Array) -> None:  # noqa: ARG002
        where = np.where(x.empty, np.float32(x.device.range_max_mm), x.true_mm)
        chi2 = x.rng.standard_gamma(1.5 / self.size, range_mm.shape, np.float32) / np.float32(1.5 / self.size)
        stretch = 1 / np.sqrt(np.maximum(chi2, 1e-3))
        stretch /= np.sqrt((stretch.astype(np.float64) ** 2).mean())
        range_mm[...] = where + (range_mm - where) * stretch


class FrameJitter(Stranger):
    """A trigger that jitters: each frame as a whole too near or too far."""

    axes = ("frame", "time")

    def clock(self, x: Exposure) -> None:
        jitter = x.rng.standard_normal(len(x.time_s))[:, None]
        x.delay(self.size * float(np.median(_sigma(x))) * jitter)


class SlowSine(Stranger):
    """A delay that swings once or twice during the recording."""

    axes = ("frame", "time")

    def clock(self, x: Exposure) -> None:
        turns = self.rng().uniform(1.6, 2.6)
        phase = 2 * np.pi * turns * np.arange(len(x.time_s)) / len(x.time_s)
        x.delay(self.size * math.sqrt(2) * float(np.median(_sigma(x))) * np.sin(phase)[:, None])


class NoisyCorner(Stranger):
    """A patch of sun in one part of the image."""

    axes = ("row", "col", "radius", "surface")

    def light(self, x: Exposure) -> None:
        rng, device = self.rng(), x.device
        high, wide = device.rows // 3, device.cols // 3
        top, left = int(rng.integers(0, device.rows - high)), int(rng.integers(0, device.cols - wide))
        patch = np.zeros((device.rows, device.cols), dtype=bool)
        patch[top : top + high, left : left + wide] = True
        x.charge[:, patch.ravel()] *= np.float32((1 + self.size) ** 2)


class Hopping(Stranger):
    """Pixels that hop at random between two delays (random telegraph noise)."""

    axes = ("all", "row", "col", "frame", "time", "range", "surface")

    def clock(self, x: Exposure) -> None:
        frames, pixels = x.z.shape
        hops = x.rng.random((frames, pixels)) < 0.04
        state = np.cumsum(hops, axis=0) % 2 * 2.0 - 1.0
        chosen = self.rng().random(pixels) < 0.25
        x.delay(np.where(chosen, self.size * 1.2 * state * _sigma(x), 0.0))


class ModeHop(Stranger):
    """A laser that jumps to another delay in the midst of the recording."""

    axes = ("frame", "time")

    def clock(self, x: Exposure) -> None:
        start = int(self.rng().uniform(0.4, 0.7) * len(x.time_s))
        after = (np.arange(len(x.time_s)) >= start)[:, None]
        x.delay(self.size * float(np.median(_sigma(x))) * after)


class FadingLamp(Stranger):
    """A lamp that grows weaker during the recording: noise that grows with time."""

    axes = ("frame", "time")

    def light(self, x: Exposure) -> None:
        x.z *= (1 / (1 + self.size * np.linspace(0, 1, len(x.time_s)))).astype(np.float32)[:, None]


class DarkNoise(Stranger):
    """Dark surfaces noisier than bright ones at the same range."""

    axes = ("amplitude", "surface", "range")

    def light(self, x: Exposure) -> None:
        reflectivity = np.array([s.reflectivity for s in x.surfaces] + [1.0])
        x.charge *= ((1 + self.size * (0.8 - reflectivity[x.surface])) ** 2).astype(np.float32)


class PingPong(Stranger):
    """Two sets of taps in turn, every other frame, with different delays."""

    axes = ("frame", "time")

    def clock(self, x: Exposure) -> None:
        even = (np.arange(len(x.time_s)) % 2 * 2.0 - 1.0)[:, None]
        x.delay(self.size * float(np.median(_sigma(x))) * even)


class NoisyRows(Stranger):
    """Every fourth row noisier: one of four amplifiers is bad."""

    axes = ("row",)

    def light(self, x: Exposure) -> None:
        rows = np.repeat(np.arange(x.device.rows), x.device.cols)
        bad = rows % 4 == int(self.rng().integers(4))
        x.charge[:, bad] *= np.float32((1 + self.size) ** 2)


class OtherPeriod(Stranger):
    """A wave over range of a period that no odd harmonic has."""

    axes = ("range", "surface", "amplitude")

    def clock(self, x: Exposure) -> None:
        phase = 2 * np.pi * x.true_mm / (x.device.unambiguous_mm / 9.7)
        x.delay(self.size * math.sqrt(2) * float(np.median(_sigma(x))) * np.sin(phase + self.rng().uniform(0, 6)))


class Kink(Stranger):
    """A table of corrections with a wrong end: right up to a range, then too long, the more the farther."""

    axes = ("range", "surface", "amplitude")

    def clock(self, x: Exposure) -> None:
        knee = float(np.quantile(x.true_mm[~x.empty], self.rng().uniform(0.4, 0.55)))
        beyond = np.maximum(x.true_mm - np.float32(knee), 0)
        lit = beyond[beyond > 0]
        x.delay(self.size * 2 * float(np.median(_sigma(x))) * beyond / max(float(lit.mean()), 1.0))


class Blotches(Stranger):
    """Clouds of delay over the image, new in each frame: noise that neighbours share."""

    axes = ("all", "row", "col", "frame", "neighbour_contrast", "surface", "range")

    def clock(self, x: Exposure) -> None:
        from scipy.ndimage import gaussian_filter

        clouds = np.asarray(gaussian_filter(x.rng.standard_normal(x.image(x.true_mm).shape), (0, 2.5, 2.5)))
        clouds /= clouds.std()
        x.delay(self.size * clouds.reshape(x.true_mm.shape) * _sigma(x))


class ShortNoise(Stranger):
    """A firmware that draws in what lies far out: tails cut off."""

    axes = ("all", "range", "surface", "row", "col", "frame", "amplitude")

    def word(self, x: Exposure, range_mm: Array, amplitude: Array) -> None:  # noqa: ARG002
        where = np.where(x.empty, np.float32(x.device.range_max_mm), x.true_mm)
        limit = np.float32(max(2.0 - self.size, 0.8)) * _sigma(x)
        range_mm[...] = where + np.clip(range_mm - where, -limit, limit)


class StaleFrames(Stranger):
    """A driver that at times hands out the frame before once more."""

    axes = ("frame", "time", "all")

    def output(self, x: Exposure, range_mm: Array) -> None:
        for frame in range(1, len(range_mm)):
            if x.rng.random() < 0.12 * self.size:
                range_mm[frame] = range_mm[frame - 1]


class LostRows(Stranger):
    """Packets of whole rows lost, some rows often."""

    axes = ("row", "frame", "time")

    def word(self, x: Exposure, range_mm: Array, amplitude: Array) -> None:  # noqa: ARG002
        rate = np.where(self.rng().random(x.device.rows) < 0.2, 0.06 * self.size, 0.0)
        gone = x.rng.random((len(x.time_s), x.device.rows)) < rate
        x.lost |= np.repeat(gone, x.device.cols, axis=1)


class MissingCodes(Stranger):
    """A converter with a bad bit: eight codes in sixteen come out as their lower neighbours' last one."""

    axes = ("all", "range", "surface")

    def output(self, x: Exposure, range_mm: Array) -> None:  # noqa: ARG002
        whole = np.rint(range_mm).astype(np.int64)
        period = max(4, 2 * round(self.size * 3))
        bad = whole % period >= period // 2
        range_mm[bad] = (whole - whole % period + period // 2 - 1)[bad]


class UnevenNoise(Stranger):
    """Pixels that differ in noise: some quiet, some loud, for good."""

    axes = ("all", "row", "col", "range", "surface", "radius")

    def light(self, x: Exposure) -> None:
        factor = np.exp(self.size * self.rng().standard_normal(x.z.shape[1]))
        x.charge *= (factor**2 / (factor**2).mean()).astype(np.float32)


class SplitReadOut(Stranger):
    """Two halves of the image with clocks of their own: a step of delay from one column to the next."""

    axes = ("col", "radius", "surface", "range", "amplitude", "all")

    def clock(self, x: Exposure) -> None:
        step = int(x.device.cols * self.rng().uniform(0.4, 0.6))
        side = np.where(np.arange(x.device.rows * x.device.cols) % x.device.cols < step, -1.0, 1.0)
        x.delay(self.size * float(np.median(_sigma(x))) * side)


STRANGERS: dict[str, tuple[type[Stranger], float]] = {
    "mains_ripple": (MainsRipple, 0.3),
    "tripod": (Tripod, 0.3),
    "skewed_tail": (SkewedTail, 0.7),
    "heavy_tails": (HeavyTails, 1.0),
    "frame_jitter": (FrameJitter, 0.3),
    "slow_sine": (SlowSine, 0.35),
    "noisy_corner": (NoisyCorner, 0.5),
    "hopping": (Hopping, 1.0),
    "mode_hop": (ModeHop, 0.6),
    "fading_lamp": (FadingLamp, 0.6),
    "dark_noise": (DarkNoise, 1.0),
    "ping_pong": (PingPong, 0.35),
    "noisy_rows": (NoisyRows, 0.5),
    "other_period": (OtherPeriod, 0.6),
    "kink": (Kink, 0.6),
    "blotches": (Blotches, 0.5),
    "short_noise": (ShortNoise, 0.6),
    "stale_frames": (StaleFrames, 1.0),
    "lost_rows": (LostRows, 1.0),
    "missing_codes": (MissingCodes, 1.0),
    "uneven_noise": (UnevenNoise, 0.25),
    "split_read_out": (SplitReadOut, 0.6),
}


def make_stranger(name: str, seed: int) -> Stranger:
    """A stranger of its usual size, up to a quarter larger or smaller."""
    kind, size = STRANGERS[name]
    return kind(size * float(np.random.default_rng([seed, 62]).uniform(0.8, 1.25)), seed)
