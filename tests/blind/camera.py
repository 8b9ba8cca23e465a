"""A lock-in camera at the level of its taps: electrons in, ranges out.

Use `record` to make a recording of a scene, with or without mechanisms that disturb it. In each frame and pixel the
light of one surface of the beam arrives (which one is drawn by area share, as the paper's equation (1) has it), four
correlation samples of electrons are taken a quarter period apart, each with the shot noise of all the light in it and
with read-out noise, and the phase of the four is the range. Nothing here knows the package or its files.

The ambient light is of one of two kinds (`Device.charge`). Without `room_electrons` it grows with the square of
reflectivity times the cosine of incidence, so that sigma depends on the range alone and a dark board is not noisier
than a bright one at the same place: a concession to model files without noise by amplitude. With `room_electrons` it is
alike on all surfaces, and sigma depends on the amplitude alone. All else that changes the amplitude (falling
illumination, a second bounce, leaking neighbours) changes the noise as physics has it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from blind.geometry import Array, Beams, Lens, Surface, View, cast

LIGHT_MM_S = 2.99792458e11  # speed of light
READ_OUT = 60.0  # electrons, each tap
STANDARD_GLOSS = 0.5  # reflectivity times cosine of the board that stands for a range


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """One camera: image, light, clock and noise.

    Its noise, as designed, is sigma(r)^2 = (`noise_linear` r)^2 + (`noise_square` r^2)^2, r in m and sigma in mm, or
    with `room_electrons` that of so many ambient electrons a tap, whatever the surface; what it measures is found on
    flat fields (`blind.calibrate`). With a `lens` the fields of view say nothing.
    """

    name: str
    rows: int = 64
    cols: int = 80
    fov_horizontal_deg: float = 60.0
    fov_vertical_deg: float = 48.0
    frequency_hz: float = 20.0e6
    integration_time_ms: float = 1.2
    frame_rate_hz: float = 25.0
    frames: int = 250
    range_min_mm: float = 300.0
    range_max_mm: float = 7000.0
    outlier_probability: float = 1.0e-4
    noise_linear: float = 2.0
    noise_square: float = 1.5
    electrons: float = 2.0e7  # amplitude from 1 m, reflectivity 1, head-on
    room_electrons: float | None = None
    lens: Lens | None = None

    @property
    def unambiguous_mm(self) -> float:
        """d_u = c / (2 f)."""
        return LIGHT_MM_S / (2 * self.frequency_hz)

    @property
    def view(self) -> View:
        """The image."""
        return View(
            rows=self.rows,
            cols=self.cols,
            fov_horizontal_deg=self.fov_horizontal_deg,
            fov_vertical_deg=self.fov_vertical_deg,
            range_max_mm=self.range_max_mm,
            lens=self.lens,
        )

    @property
    def amplitude_unit(self) -> float:
        """Amplitude that the camera reports for one electron."""
        return 1000.0 * self.integration_time_ms / 1.2 / self.electrons

    def design_sigma(self, range_mm: Array | float) -> Array:
        """The noise it is built for, mm; under room light, that of a board of reflectivity 0.5 that faces it."""
        if self.room_electrons is not None:
            return self.sigma(np.asarray(range_mm, dtype=np.float64), np.array(STANDARD_GLOSS))
        r = np.asarray(range_mm) / 1000.0
        sigma: Array = np.hypot(self.noise_linear * r, self.noise_square * r**2)
        return sigma

    def sigma(self, range_mm: Array, gloss: Array) -> Array:
        """The noise it is built for on surfaces of a `gloss`, reflectivity times cosine of incidence, mm."""
        if self.room_electrons is None:
            return self.design_sigma(range_mm)
        amplitude = self.amplitude(range_mm, np.maximum(gloss, 1e-6))
        phase_noise = np.sqrt((self.charge(range_mm, gloss) + READ_OUT**2) / 2) / amplitude
        sigma: Array = phase_noise * self.unambiguous_mm / (2 * np.pi)
        return sigma

    def amplitude(self, range_mm: Array, gloss: Array) -> Array:
        """Electrons of modulated light from a surface; `gloss` is reflectivity times cosine of incidence."""
        amplitude: Array = self.electrons * gloss * (1000.0 / np.maximum(range_mm, 1.0)) ** 2
        return amplitude

    def charge(self, range_mm: Array, gloss: Array) -> Array:
        """Mean electrons of a tap, signal included, so that the phase noise is that of `sigma`."""
        if self.room_electrons is not None:
            lit: Array = self.room_electrons + self.amplitude(range_mm, gloss)
            return lit
        phase_noise = self.design_sigma(range_mm) * 2 * np.pi / self.unambiguous_mm
        charge: Array = 2 * (phase_noise * self.amplitude(range_mm, gloss)) ** 2 - READ_OUT**2
        return charge

    def phasor(self, range_mm: Array | float) -> Array:
        """Unit phasors of ranges."""
        phasor: Array = np.exp(2j * np.pi / self.unambiguous_mm * np.asarray(range_mm))
        return phasor


@dataclass(slots=True)
class Exposure:
    """All frames of a recording on their way through the camera; mechanisms change it in place.

    Arrays are (frame, pixel) unless said otherwise.
    """

    device: Device
    surfaces: list[Surface]
    time_s: Array
    rng: np.random.Generator
    key_beams: list[Beams]  # the scene at some times
    key: Array  # (frame,) which of them
    layer: Array
    surface: Array
    true_mm: Array
    z: Array
    charge: Array
    lost: Array
    seed: int = 0
    harmonics: dict[int, tuple[float, float]] = field(default_factory=dict)
    """{order: (share, phase)} of the modulation.. """
    ambient_gain: float = 1.0  # of the noise where nothing came back
    temperature_c: Array | None = None

    @property
    def beams(self) -> Beams:
        """The scene at the first frame."""
        return self.key_beams[0]

    @property
    def empty(self) -> Array:
        """Where nothing came back."""
        return np.asarray(self.layer < 0)

    def image(self, values: Array) -> Array:
        """View (frame, pixel) as (frame, row, col)."""
        return values.reshape(-1, self.device.rows, self.device.cols)

    def gloss(self, beams: Beams) -> Array:
        """Reflectivity times cosine (L, pixel) of a beam's surfaces."""
        reflectivity = np.array([s.reflectivity for s in self.surfaces])
        return np.asarray(np.where(beams.surface >= 0, reflectivity[beams.surface], 0.0) * beams.cosine)

    def layers(self) -> list[tuple[Array, Array, Array]]:
        """Share, phasor and charge (L, pixel) of all surfaces in the beams, for each key."""
        out = []
        for beams in self.key_beams:
            gloss = self.gloss(beams)
            z = self.device.amplitude(beams.range_mm, gloss) * self.device.phasor(beams.range_mm)
            out.append((beams.share, z, self.device.charge(beams.range_mm, gloss)))
        return out

    def delay(self, bias_mm: Array | float) -> None:
        """Delay the light, or the clock against it, by so many mm of range."""
        self.z *= self.device.phasor(np.asarray(bias_mm, dtype=np.float64)).astype(np.complex64)


class Mechanism:
    """Something physical that the ideal camera lacks. Each hook is one level, called in this order."""

    kind = ""

    def scene(self, surfaces: list[Surface], time_s: float) -> list[Surface]:  # noqa: ARG002
        """The surfaces at a time, as they really are."""
        return surfaces

    def light(self, x: Exposure) -> None:
        """Light on its way to the taps."""

    def clock(self, x: Exposure) -> None:
        """Delays and wave forms of the modulation."""

    def noise(self, normal: Array, rng: np.random.Generator) -> None:
        """Standard normal deviates (frame, 4, pixel) of the taps' electrons."""

    def word(self, x: Exposure, range_mm: Array, amplitude: Array) -> None:
        """The demodulated range (frame, pixel), before read-out."""

    def output(self, x: Exposure, range_mm: Array) -> None:
        """The last words on the wire, wild values included."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """What the camera delivers: ranges in whole mm, NaN where lost; arrays (frame, row, col)."""

    range_mm: Array
    amplitude: Array
    time_s: Array
    temperature_c: Array | None


def moving(mechanisms: Sequence[Mechanism]) -> bool:
    """Whether the scene changes during the recording."""
    return any(getattr(m, "moves", False) for m in mechanisms)


def expose(device: Device, surfaces: list[Surface], mechanisms: Sequence[Mechanism], seed: int) -> Exposure:
    """Draw which light arrives in each frame and pixel, and let the light's mechanisms act on it."""
    time_s = np.arange(device.frames) / device.frame_rate_hz
    keys = 8 if moving(mechanisms) else 1
    key = (np.arange(device.frames) * keys) // device.frames
    key_scenes = []
    for k in range(keys):
        scene = surfaces
        for mechanism in mechanisms:
            scene = mechanism.scene(scene, float(time_s[key == k].mean()) if keys > 1 else 0.0)
        key_scenes.append(scene)
    key_beams = [cast(scene, device.view) for scene in key_scenes]
    rng = np.random.default_rng([seed, 1])
    shape = (device.frames, device.view.pixels)
    layer = np.empty(shape, np.int8)
    surface = np.empty(shape, np.int8)
    true_mm = np.empty(shape, np.float32)
    gloss = np.empty(shape, np.float32)
    reflectivity = np.array([s.reflectivity for s in surfaces] + [0.0])
    for k, beams in enumerate(key_beams):
        frames = np.flatnonzero(key == k)
        u = rng.random((frames.size, shape[1]), dtype=np.float32)
        chosen = np.zeros(u.shape, np.int8)
        for threshold in np.cumsum(beams.share, axis=0):
            chosen += u >= threshold.astype(np.float32)
        full = beams.nothing == 0  # a rounding error must not draw a no-return
        last = np.maximum((beams.share > 0).sum(axis=0) - 1, 0)
        chosen = np.where(full, np.minimum(chosen, last), chosen).astype(np.int8)
        empty = chosen >= beams.share.shape[0]
        if beams.nothing.any():  # layers past a pixel's own are open space too
            empty |= (chosen > last) | (~full & (beams.share.sum(axis=0) == 0))
        pick = np.where(empty, 0, chosen)
        column = np.arange(shape[1])
        layer[frames] = np.where(empty, -1, chosen)
        surface[frames] = np.where(empty, -1, beams.surface[pick, column])
        true_mm[frames] = np.where(empty, 0.0, beams.range_mm[pick, column])
        gloss[frames] = np.where(empty, 0.0, beams.cosine[pick, column]) * reflectivity[surface[frames]]
    if keys > 1:
        _glide(true_mm, surface, surfaces, mechanisms, time_s, key)
    z = (device.amplitude(true_mm, gloss) * device.phasor(true_mm)).astype(np.complex64)
    z[layer < 0] = 0
    charge = device.charge(true_mm, gloss).astype(np.float32)
    charge[layer < 0] = device.charge(np.array(device.range_max_mm), np.array(STANDARD_GLOSS))
    return Exposure(
        device=device,
        surfaces=surfaces,
        time_s=time_s,
        rng=np.random.default_rng([seed, 2]),
        key_beams=key_beams,
        key=key,
        layer=layer,
        surface=surface,
        true_mm=true_mm,
        z=z,
        charge=charge,
        lost=np.zeros(shape, dtype=bool),
        seed=seed,
    )


def _glide(
    true_mm: Array, surface: Array, surfaces: list[Surface], mechanisms: Sequence[Mechanism], time_s: Array, key: Array
) -> None:
    """Between the times at which a moving scene is cast, ranges change in proportion to the planes' distances."""
    for frame, now in enumerate(time_s):
        here, there = surfaces, surfaces
        for mechanism in mechanisms:
            here = mechanism.scene(here, float(now))
            there = mechanism.scene(there, float(time_s[key == key[frame]].mean()))
        ratio = np.array([_distance(a) / _distance(b) for a, b in zip(here, there, strict=True)] + [1.0])
        true_mm[frame] *= ratio[surface[frame]]


def _distance(surface: Surface) -> float:
    return float(surface.axes()[:, 2] @ np.array(surface.center_mm))


def record(device: Device, surfaces: list[Surface], mechanisms: Sequence[Mechanism] = (), *, seed: int) -> Recording:
    """Record a scene."""
    x = expose(device, surfaces, mechanisms, seed)
    for mechanism in mechanisms:
        mechanism.light(x)
    for mechanism in mechanisms:
        mechanism.clock(x)
    phasor, wild_noise = integrate(x, mechanisms, np.random.default_rng([seed, 3]))
    range_mm = demodulate(x, phasor)
    empty = x.empty
    far = device.range_max_mm
    range_mm[empty] = far + device.design_sigma(np.array(far)) * x.ambient_gain * wild_noise[empty]
    amplitude = np.abs(phasor) * device.amplitude_unit
    for mechanism in mechanisms:
        mechanism.word(x, range_mm, amplitude)
    return _read_out(x, range_mm, amplitude, mechanisms, np.random.default_rng([seed, 4]))


def integrate(x: Exposure, mechanisms: Sequence[Mechanism], rng: np.random.Generator) -> tuple[Array, Array]:
    """Fill the four taps and form the phasor of their differences, electrons; also one standard deviate a sample.

    A tap holds thousands of electrons and more: their Poisson noise is drawn as Gaussian.
    """
    frames, pixels = x.z.shape
    phasor = np.empty(x.z.shape, np.complex64)
    spare = np.empty(x.z.shape, np.float32)
    normal = np.empty((frames, 4, pixels), np.float32) if any(_has_memory(m) for m in mechanisms) else None
    if normal is not None:
        rng.standard_normal(dtype=np.float32, out=normal)
        for mechanism in mechanisms:
            mechanism.noise(normal, rng)
    for start in range(0, frames, 25):
        part = slice(start, start + 25)
        deviates = normal[part] if normal is not None else rng.standard_normal((len(x.z[part]), 4, pixels), np.float32)
        taps = []
        for k in range(4):
            mean = x.charge[part] + _correlation(x, part, k)
            taps.append(mean + np.sqrt(np.maximum(mean, 0) + np.float32(READ_OUT**2)) * deviates[:, k])
        phasor[part] = 0.5 * ((taps[0] - taps[2]) + 1j * (taps[1] - taps[3]))
        spare[part] = (deviates[:, 1] - deviates[:, 3]) * np.float32(np.sqrt(0.5))
    return phasor, spare


def _has_memory(mechanism: Mechanism) -> bool:
    return type(mechanism).noise is not Mechanism.noise


def _correlation(x: Exposure, part: slice, tap: int) -> Array:
    """Modulated electrons of one tap: a cosine of the phase, and its harmonics."""
    z = x.z[part]
    out: Array = (z.real, z.imag, -z.real, -z.imag)[tap].copy()
    if x.harmonics:
        size, phase = np.abs(z), np.angle(z) - tap * np.float32(np.pi / 2)
        for order, (share, shift) in x.harmonics.items():
            out += np.float32(share) * size * np.cos(order * phase + np.float32(shift))
    return out


def demodulate(x: Exposure, phasor: Array) -> Array:
    """Range (frame, pixel) float32 of the taps' phasor, on the turn nearest the surface (a second frequency tells)."""
    turn = x.device.phasor(-x.true_mm).astype(np.complex64)
    range_mm: Array = x.true_mm + np.float32(x.device.unambiguous_mm / (2 * np.pi)) * np.angle(phasor * turn)
    return range_mm.astype(np.float32)


def _read_out(
    x: Exposure, range_mm: Array, amplitude: Array, mechanisms: Sequence[Mechanism], rng: np.random.Generator
) -> Recording:
    """Wild values of the ideal camera, then the last mechanisms, then whole millimetres."""
    device = x.device
    wild = rng.random(range_mm.shape, dtype=np.float32) < device.outlier_probability
    range_mm[wild] = rng.uniform(device.range_min_mm, device.range_max_mm, int(wild.sum()))
    x.lost[wild] = False
    for mechanism in mechanisms:
        mechanism.output(x, range_mm)
    stored = np.clip(np.rint(range_mm), 1, 65534).astype(np.float32)
    stored[x.lost] = np.nan
    return Recording(
        range_mm=x.image(stored),
        amplitude=x.image(amplitude.astype(np.float32)),
        time_s=x.time_s,
        temperature_c=x.temperature_c,
    )
