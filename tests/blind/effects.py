"""One physical mechanism for each effect kind of the model files, and its equivalent in the model files' terms.

Each mechanism is what happens in a camera (`physical`); `equivalent` says which parameters of the effect kind come
nearest to it, derived here and checked against the camera itself in the tests.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from blind.camera import LIGHT_MM_S, READ_OUT, Device, Exposure, Mechanism
from blind.geometry import Array, Beams, Surface

Parameters = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a mechanism acts: camera, true scene, what its beams meet."""

    device: Device
    surfaces: list[Surface]
    beams: Beams

    def amplitudes(self) -> Array:
        """Reported amplitudes of the image's surfaces, one for each (layer, pixel) with a share over a half."""
        reflectivity = np.array([s.reflectivity for s in self.surfaces])
        main = self.beams.share > 0.5
        gloss = reflectivity[self.beams.surface[main]] * self.beams.cosine[main]
        return np.asarray(self.device.amplitude(self.beams.range_mm[main], gloss) * self.device.amplitude_unit)

    def sigmas(self) -> Array:
        """Their standard deviations, mm."""
        return np.asarray(self.sigma_map()[self.beams.share > 0.5])

    def sigma_map(self) -> Array:
        """Standard deviation (L, pixel) of each surface of a beam, mm."""
        reflectivity = np.array([s.reflectivity for s in self.surfaces])
        return self.device.sigma(self.beams.range_mm, reflectivity[self.beams.surface] * self.beams.cosine)


class Effect(Mechanism):
    """A mechanism with a kind of the model files."""

    def physical(self) -> Parameters:
        """Its physical parameters."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}  # type: ignore[attr-defined]

    def equivalent(self, place: Place) -> Parameters:  # noqa: ARG002
        """The parameters of `kind` that come nearest: its own, if the kind's law is the same."""
        return self.physical()

    def map(self, device: Device) -> Array | None:  # noqa: ARG002
        """The device's own map (row, col), if the mechanism has one."""
        return None


@dataclass(frozen=True, kw_only=True)
class CableDelay(Effect):
    """A trigger line that is longer than the calibration says."""

    delay_ps: float
    kind = "range_offset"

    def clock(self, x: Exposure) -> None:
        x.delay(self.delay_ps * 0.0299792458 * 5)

    def equivalent(self, place: Place) -> Parameters:  # noqa: ARG002
        return {"offset_mm": self.delay_ps * 0.0299792458 * 5}  # c / 2 in mm/ps is 0.1499


@dataclass(frozen=True, kw_only=True)
class MisplacedBoard(Effect):
    """A board that stands elsewhere than the plan says."""

    surface: str
    shift_mm: float
    kind = "surface_pose"

    def scene(self, surfaces: list[Surface], time_s: float) -> list[Surface]:  # noqa: ARG002
        return [s.shifted(self.shift_mm) if s.name == self.surface else s for s in surfaces]


@dataclass(frozen=True, kw_only=True)
class Harmonics(Effect):
    """Third, fifth and ninth harmonic of the modulation, as shares of the fundamental.

    Four taps see e^(i phi) + h3 e^(-i (3 phi + p3)) + h5 e^(i (5 phi + p5)): relative to the fundamental both turn
    with 4 phi, and the phase error is -h3 sin(4 phi + p3) + h5 sin(4 phi + p5). The ninth turns with 8 phi.
    """

    third: float
    third_phase: float
    fifth: float
    fifth_phase: float
    ninth: float = 0.0
    ninth_phase: float = 0.0
    kind = "wiggling"

    def clock(self, x: Exposure) -> None:
        x.harmonics = {3: (self.third, self.third_phase), 5: (self.fifth, self.fifth_phase)}
        if self.ninth:
            x.harmonics[9] = (self.ninth, self.ninth_phase)

    def equivalent(self, place: Place) -> Parameters:
        wave = -self.third * np.exp(1j * self.third_phase) + self.fifth * np.exp(1j * self.fifth_phase)
        radian_mm = place.device.unambiguous_mm / (2 * np.pi)
        own = {"amplitude_mm": float(radian_mm * abs(wave)), "phase_rad": float(np.angle(wave))}
        return own | ({"harmonics": ((8.0, radian_mm * self.ninth, self.ninth_phase),)} if self.ninth else {})


@dataclass(frozen=True, kw_only=True)
class UnequalTaps(Effect):
    """Two differences of charges of unequal gain, and an imbalance of the taps for light that is not modulated.

    The taps see the phase against their own clock, which is early by `clock_rad`; the calibration takes that off again.
    With a gain of 1 + g for the first difference, the phasor z is z + g Re z; with an imbalance, each difference has a
    part of the light's own mean, which is in proportion to |z|.
    """

    gain: float
    common: complex
    clock_rad: float
    kind = "tap_mismatch"

    def clock(self, x: Exposure) -> None:
        early = np.exp(1j * self.clock_rad)
        seen = x.z * early
        seen = seen + self.gain * seen.real + self.common * np.abs(seen)
        x.z = (seen / early / (1 + self.gain / 2)).astype(np.complex64)

    def equivalent(self, place: Place) -> Parameters:
        """The circle is moved by the imbalance, and made an ellipse by g z* / 2, seen at once and twice the phase."""
        once = -np.conj(self.common) * np.exp(1j * self.clock_rad)
        twice = -self.gain / 2 * np.exp(2j * self.clock_rad)
        radian_mm = place.device.unambiguous_mm / (2 * np.pi)
        return {
            "amplitude_1_mm": float(radian_mm * abs(once)),
            "phase_1_rad": float(np.angle(once)),
            "amplitude_2_mm": float(radian_mm * abs(twice)),
            "phase_2_rad": float(np.angle(twice)),
        }


@dataclass(frozen=True, kw_only=True)
class ChargeLag(Effect):
    """Transit to the taps by self-induced drift: few electrons are late, t = t0 / (1 + n / n0).

    For n far above n0 that is the power law with exponent 1. It is compared as a curve.
    """

    late_mm: float  # c t0 / 2
    knee_amplitude: float  # n0, in reported amplitude
    kind = "amplitude_walk"

    def bias(self, amplitude: Array) -> Array:
        """Range bias, mm, at reported amplitudes."""
        return np.asarray(self.late_mm / (1 + amplitude / self.knee_amplitude))

    def clock(self, x: Exposure) -> None:
        x.delay(self.bias(np.abs(x.z) * x.device.amplitude_unit))

    def equivalent(self, place: Place) -> Parameters:
        reference = float(np.exp(np.log(place.amplitudes()).mean()))
        scale = self.late_mm * self.knee_amplitude / reference
        return {
            "scale_mm": scale,
            "reference_amplitude": reference,
            "exponent": 1.0,
            "saturation_amplitude": self.knee_amplitude,
        }


@dataclass(frozen=True, kw_only=True)
class WarmUp(Effect):
    """A driver whose delay follows its temperature, which nears its end value exponentially; and its chip, sooner."""

    delay_mm_per_kelvin: float
    rise_kelvin: float
    time_constant_s: float
    chip_mm: float = 0.0
    chip_time_constant_s: float = 1.0
    kind = "temperature_drift"

    def clock(self, x: Exposure) -> None:
        warmer = self.rise_kelvin * -np.expm1(-x.time_s / self.time_constant_s)
        x.temperature_c = (24.0 + warmer).astype(np.float32)
        chip_mm = self.chip_mm * -np.expm1(-x.time_s / self.chip_time_constant_s)
        x.delay((self.delay_mm_per_kelvin * warmer + chip_mm)[:, None])

    def equivalent(self, place: Place) -> Parameters:  # noqa: ARG002
        chip = {"amplitude_2_mm": self.chip_mm, "time_constant_2_s": self.chip_time_constant_s}
        return {
            "amplitude_mm": self.delay_mm_per_kelvin * self.rise_kelvin,
            "time_constant_s": self.time_constant_s,
        } | (chip if self.chip_mm else {})


@dataclass(frozen=True, kw_only=True)
class DelayLines(Effect):
    """Each pixel's own delay, and those of the lines that feed columns and rows."""

    pixel_mm: float
    column_mm: float
    row_mm: float
    wafer: int  # seed of this device's delays
    kind = "fixed_pattern"

    def map(self, device: Device) -> Array:
        rng = np.random.default_rng([self.wafer, 51])
        out = self.pixel_mm * rng.standard_normal((device.rows, device.cols))
        out += self.column_mm * rng.standard_normal(device.cols)
        out += self.row_mm * rng.standard_normal(device.rows)[:, None]
        return np.asarray(out)

    def clock(self, x: Exposure) -> None:
        x.delay(self.map(x.device).reshape(1, -1))

    def equivalent(self, place: Place) -> Parameters:  # noqa: ARG002
        return {"pixel_sigma_mm": self.pixel_mm, "column_sigma_mm": self.column_mm, "row_sigma_mm": self.row_mm}


@dataclass(frozen=True, kw_only=True)
class FeedLine(Effect):
    """A clock line without buffers, fed at one side of the image; the calibration is that of the centre.

    The delay at a part s of a line of resistance R and capacitance C is RC (s - s^2 / 2) (Elmore 1948).
    """

    rc_mm: float  # as a range
    along: str  # columns ("across") or rows ("down")
    kind = "smooth_pattern"

    def map(self, device: Device) -> Array:
        count, axis = (device.cols, 1) if self.along == "across" else (device.rows, 0)
        part = np.linspace(0, 1, count)
        delay = part - part**2 / 2
        shown = np.broadcast_to(np.expand_dims(delay - 0.375, 1 - axis), (device.rows, device.cols))
        return np.asarray(self.rc_mm * shown)

    def clock(self, x: Exposure) -> None:
        x.delay(self.map(x.device).reshape(1, -1))

    def equivalent(self, place: Place) -> Parameters:
        """The delay less that of the centre is RC (u / 4 - u^2 / 8), u from -1 to 1; x is u times this many halves."""
        rows, cols = place.device.rows, place.device.cols
        edge = ((cols if self.along == "across" else rows) - 1) / math.hypot(rows - 1, cols - 1)
        return {f"{self.along}_mm": self.rc_mm / 4 / edge, f"{self.along}_2_mm": -self.rc_mm / 8 / edge**2}


@dataclass(frozen=True, kw_only=True)
class StrayLight(Effect):
    """Light that the lens scatters over the whole image, before the taps: phasor and charge."""

    share: float
    kind = "scattering"

    def light(self, x: Exposure) -> None:
        lit = ~x.empty
        veil = x.z.mean(axis=1, keepdims=True)
        x.charge += np.float32(self.share) * np.where(lit, x.charge, 0).mean(axis=1, keepdims=True)
        x.z = np.where(lit, x.z + np.float32(self.share) * veil, x.z)


@dataclass(frozen=True, kw_only=True)
class SecondBounce(Effect):
    """Light that reaches one surface by way of another: a second path, longer in all by `extra_path_mm`."""

    surface: str
    share: float
    extra_path_mm: float
    kind = "multipath"

    def light(self, x: Exposure) -> None:
        number = [s.name for s in x.surfaces].index(self.surface)
        on = x.surface == number
        turned = self.share * x.device.phasor(np.array(self.extra_path_mm / 2))
        x.charge[on] += np.float32(self.share) * np.abs(x.z[on])
        x.z[on] *= np.complex64(1 + turned)


@dataclass(frozen=True, kw_only=True)
class WaxBoard(Effect):
    """A board that light enters: it comes out after ways of an exponential distribution, of a mean as a range."""

    surface: str
    depth_mm: float
    kind = "surface_offset"

    def response(self, device: Device) -> complex:
        """The mean of exp(i k s) over the ways: 1 / (1 - i k depth), k = 2 pi / d_u."""
        return 1 / (1 - 2j * math.pi * self.depth_mm / device.unambiguous_mm)

    def light(self, x: Exposure) -> None:
        on = x.surface == [s.name for s in x.surfaces].index(self.surface)
        x.z[on] *= np.complex64(self.response(x.device))

    def equivalent(self, place: Place) -> Parameters:
        turn = float(np.angle(self.response(place.device)))
        return {"surface": self.surface, "offset_mm": turn * place.device.unambiguous_mm / (2 * math.pi)}


@dataclass(frozen=True, kw_only=True)
class WindowGlare(Effect):
    """Light of the lamp that the window throws straight back into the lens: so many electrons, after a short way."""

    glare_electrons: float
    way_mm: float  # there and back
    kind = "internal_reflection"

    def light(self, x: Exposure) -> None:
        lit = ~x.empty
        glare = self.glare_electrons * x.device.phasor(np.array(self.way_mm / 2))
        x.z = np.where(lit, x.z + np.complex64(glare), x.z)
        x.charge += np.where(lit, np.float32(self.glare_electrons), np.float32(0))

    def equivalent(self, place: Place) -> Parameters:
        return {"amplitude": self.glare_electrons * place.device.amplitude_unit, "range_mm": self.way_mm / 2}


@dataclass(frozen=True, kw_only=True)
class WindowEcho(Effect):
    """A pulse timer that is set off by the window's own echo in some of its shots, whatever is behind."""

    share_of_shots: float
    gap_mm: float
    jitter_ps: float
    kind = "near_return"

    def jitter_mm(self) -> float:
        """The timer's spread, as a range."""
        return self.jitter_ps * 1e-12 * LIGHT_MM_S / 2

    def word(self, x: Exposure, range_mm: Array, amplitude: Array) -> None:
        first = x.rng.random(range_mm.shape, dtype=np.float32) < self.share_of_shots
        echoes = int(first.sum())
        range_mm[first] = self.gap_mm + self.jitter_mm() * x.rng.standard_normal(echoes)
        amplitude[first] = 0

    def equivalent(self, place: Place) -> Parameters:  # noqa: ARG002
        return {"share": self.share_of_shots, "range_mm": self.gap_mm, "sigma_mm": self.jitter_mm()}


@dataclass(frozen=True, kw_only=True)
class OneFrequency(Effect):
    """A camera whose second frequency is off: nothing tells the turn, and ranges beyond d_u fold."""

    kind = "phase_wrapping"

    def word(self, x: Exposure, range_mm: Array, amplitude: Array) -> None:  # noqa: ARG002
        lit = ~x.empty
        range_mm[lit] = np.mod(range_mm[lit], np.float32(x.device.unambiguous_mm))

    def equivalent(self, place: Place) -> Parameters:
        return {"unambiguous_range_mm": place.device.unambiguous_mm}


@dataclass(frozen=True, kw_only=True)
class WholeBeam(Effect):
    """Frames in which a pixel integrates its whole beam: the phasors of all surfaces add by area, open space is dark.

    A sample that was to be of open space is counted as one of the brightest surface, whose turn it is on.
    """

    probability: float
    kind = "flying_pixels"

    def light(self, x: Exposure) -> None:
        for k, (share, z, charge) in enumerate(x.layers()):
            beams = x.key_beams[k]
            surfaces = (share > 0).sum(axis=0)
            several = np.flatnonzero((surfaces > 1) | ((surfaces > 0) & (beams.nothing > 0)))
            frames = np.flatnonzero(x.key == k)
            dark = x.device.charge(np.array(x.device.range_max_mm), np.array(0.5))
            total = (share * z).sum(axis=0)[several]
            held = (np.where(share > 0, share * charge, 0).sum(axis=0) + beams.nothing * dark)[several]
            block = np.ix_(frames, several)
            hit = x.rng.random((frames.size, several.size)) < self.probability
            brightest = np.argmax(np.abs(share * z), axis=0)[several]
            dark_hit = hit & (x.layer[block] < 0)
            x.layer[block] = np.where(dark_hit, brightest, x.layer[block])
            x.surface[block] = np.where(dark_hit, beams.surface[brightest, several], x.surface[block])
            x.true_mm[block] = np.where(dark_hit, beams.range_mm[brightest, several], x.true_mm[block])
            x.z[block] = np.where(hit, total, x.z[block])
            x.charge[block] = np.where(hit, held, x.charge[block])


@dataclass(frozen=True, kw_only=True)
class AmbientLight(Effect):
    """More sun than on the day of the calibration: so many times the ambient electrons, the signal as it was."""

    times: float
    kind = "excess_noise"

    def light(self, x: Exposure) -> None:
        own = np.abs(x.z)
        x.charge += np.float32(self.times - 1) * np.maximum(x.charge - own, 0)
        x.ambient_gain *= math.sqrt(self.times)

    def equivalent(self, place: Place) -> Parameters:  # noqa: ARG002
        return {"factor": math.sqrt(self.times)}


@dataclass(frozen=True, kw_only=True)
class SunOnBoard(Effect):
    """Sun through a window onto one board: so many times its ambient electrons, the signal as it was."""

    surface: str
    times: float
    kind = "excess_noise"

    def light(self, x: Exposure) -> None:
        on = x.surface == [s.name for s in x.surfaces].index(self.surface)
        ambient = np.maximum(x.charge - np.abs(x.z), 0)
        x.charge += np.where(on, np.float32(self.times - 1) * ambient, np.float32(0))

    def equivalent(self, place: Place) -> Parameters:  # noqa: ARG002
        return {"factor": math.sqrt(self.times), "surface": self.surface}


@dataclass(frozen=True, kw_only=True)
class RoomAtAngles(Effect):
    """Background light that does not fall with the signal of slanted surfaces, as that of a board that faces does.

    Each sample's electrons that are no read-out noise are those of a surface that faces the camera at its range, and
    the signal is weaker by the cosine of incidence: sigma grows as its inverse.
    """

    kind = "excess_noise"

    def light(self, x: Exposure) -> None:
        cosine = x.beams.cosine[np.maximum(x.layer, 0), np.arange(x.z.shape[1])]
        facing = (x.charge + np.float32(READ_OUT**2)) / np.maximum(cosine, 1e-3) ** 2 - np.float32(READ_OUT**2)
        x.charge[...] = np.where(x.empty, x.charge, facing)

    def equivalent(self, place: Place) -> Parameters:  # noqa: ARG002
        return {"factor": 1.0, "angle_exponent": 1.0}


@dataclass(frozen=True, kw_only=True)
class FallingIllumination(Effect):
    """A lamp that is weaker off its axis, as cos(angle)^power."""

    power: float
    kind = "vignetting"

    @staticmethod
    def axis_cosine(device: Device) -> Array:
        """Cosine (pixel,) of the angle to the axis."""
        azimuth, elevation = device.view.angles()
        return np.asarray(np.cos(azimuth) * np.cos(elevation))

    def light(self, x: Exposure) -> None:
        x.z *= (self.axis_cosine(x.device) ** self.power).astype(np.float32)

    def equivalent(self, place: Place) -> Parameters:
        return {"corner_factor": float(self.axis_cosine(place.device).min() ** -self.power)}


@dataclass(frozen=True, kw_only=True)
class WildValues(Effect):
    """Upsets of the converter: any value in the working range."""

    probability: float
    kind = "outliers"

    def output(self, x: Exposure, range_mm: Array) -> None:
        hit = x.rng.random(range_mm.shape, dtype=np.float32) < self.probability
        range_mm[hit] = x.rng.uniform(x.device.range_min_mm, x.device.range_max_mm, int(hit.sum()))
        x.lost[hit] = False


@dataclass(frozen=True, kw_only=True)
class DeadTaps(Effect):
    """Pixels whose taps hold a fixed charge: one phase for ever."""

    share: float
    value_mm: float
    wafer: int
    kind = "stuck_pixels"

    def map(self, device: Device) -> Array:
        dead = np.random.default_rng([self.wafer, 52]).random((device.rows, device.cols)) < self.share
        if not dead.any():
            dead[device.rows // 3, device.cols // 3] = True
        return np.where(dead, self.value_mm, np.nan)

    def output(self, x: Exposure, range_mm: Array) -> None:
        values = self.map(x.device).ravel()
        dead = np.isfinite(values)
        range_mm[:, dead] = values[dead]
        x.lost[:, dead] = False

    def equivalent(self, place: Place) -> Parameters:
        return {"share": float(np.isfinite(self.map(place.device)).mean()), "value_mm": self.value_mm}


@dataclass(frozen=True, kw_only=True)
class LostSamples(Effect):
    """Lost packets, and a comparator that rejects what it measures as too weak."""

    packet_loss: float
    threshold: float
    comparator_noise: float
    kind = "dropout"

    def word(self, x: Exposure, range_mm: Array, amplitude: Array) -> None:
        measured = amplitude + np.float32(self.comparator_noise) * x.rng.standard_normal(range_mm.shape, np.float32)
        if self.threshold > 0:
            x.lost |= measured < self.threshold
        x.lost |= x.rng.random(range_mm.shape, dtype=np.float32) < self.packet_loss

    def equivalent(self, place: Place) -> Parameters:
        """The measured amplitude's own noise at the threshold adds to the comparator's."""
        if self.threshold <= 0:
            return {"probability": self.packet_loss, "threshold": 0.0, "threshold_noise": 0.0}
        device = place.device
        near = np.argsort(np.abs(np.log(place.amplitudes() / self.threshold)))[:200]
        phase_noise = place.sigmas()[near] * 2 * np.pi / device.unambiguous_mm
        own = self.threshold * float(np.sqrt(np.mean(phase_noise**2)))
        return {
            "probability": self.packet_loss,
            "threshold": self.threshold,
            "threshold_noise": math.hypot(own, self.comparator_noise),
        }


@dataclass(frozen=True, kw_only=True)
class Memory(Effect):
    """Electrons' noise that lingers from frame to frame."""

    coefficient: float
    kind = "temporal_correlation"

    def noise(self, normal: Array, rng: np.random.Generator) -> None:  # noqa: ARG002
        keep, fresh = np.float32(self.coefficient), np.float32(math.sqrt(1 - self.coefficient**2))
        for frame in range(1, len(normal)):
            normal[frame] *= fresh
            normal[frame] += keep * normal[frame - 1]


@dataclass(frozen=True, kw_only=True)
class SecondCamera(Effect):
    """Another camera beside this one, in bursts: its light returns from the same surfaces with a phase at random."""

    strength: float  # its amplitude as a share of our own
    share_of_frames: float
    burst_frames: int
    kind = "interference"

    def bursts(self, frames: int, seed: int) -> Array:
        """Which frames (frame,) of a recording it lights: bursts of the length, two at either side, gaps at random."""
        rng = np.random.default_rng([seed, 53])
        count = max(1, round(self.share_of_frames * frames / self.burst_frames))
        lengths = rng.integers(self.burst_frames - 2, self.burst_frames + 3, count)
        starts = np.sort(rng.integers(0, max(frames - int(lengths.sum()), 1), count))  # among the frames without light
        on = np.zeros(frames, dtype=bool)
        for start, length in zip(starts + np.cumsum(lengths) - lengths, lengths, strict=True):
            on[start : start + length] = True
        return on

    def light(self, x: Exposure) -> None:
        on = np.flatnonzero(self.bursts(len(x.time_s), x.seed))
        shape = (on.size, x.z.shape[1])
        other = x.rng.standard_normal(shape, np.float32) + 1j * x.rng.standard_normal(shape, np.float32)
        x.z[on] += np.float32(self.strength / math.sqrt(2)) * np.abs(x.z[on]) * other

    def equivalent(self, place: Place) -> Parameters:
        return {
            "probability": self.share_of_frames,
            "sigma_mm": float(place.device.unambiguous_mm / (2 * np.pi) * self.strength / math.sqrt(2)),
            "burst_frames": self.burst_frames,
        }


@dataclass(frozen=True, kw_only=True)
class FullWell(Effect):
    """Wells behind the background suppression that fill with the signal's own charge."""

    capacity_electrons: float
    kind = "saturation"

    def word(self, x: Exposure, range_mm: Array, amplitude: Array) -> None:  # noqa: ARG002
        own = np.abs(x.z)
        own = own + np.sqrt(own) * x.rng.standard_normal(own.shape, np.float32)
        x.lost |= own > self.capacity_electrons

    def equivalent(self, place: Place) -> Parameters:
        return {"full_well_amplitude": self.capacity_electrons * place.device.amplitude_unit}


@dataclass(frozen=True, kw_only=True)
class MovingBoard(Effect):
    """A board that moves along its normal while the camera records."""

    surface: str
    velocity_mm_s: float
    kind = "motion"
    moves = True

    def scene(self, surfaces: list[Surface], time_s: float) -> list[Surface]:
        return [s.shifted(self.velocity_mm_s * time_s) if s.name == self.surface else s for s in surfaces]


@dataclass(frozen=True, kw_only=True)
class CoarsePhase(Effect):
    """A phase register of few levels a turn."""

    levels: int
    kind = "quantisation"

    def step(self, device: Device) -> float:
        """Range of one level, mm."""
        return device.unambiguous_mm / self.levels

    def output(self, x: Exposure, range_mm: Array) -> None:
        step = self.step(x.device)
        range_mm[...] = np.rint(range_mm.astype(np.float64) / step) * step

    def equivalent(self, place: Place) -> Parameters:
        return {"step_mm": self.step(place.device)}


@dataclass(frozen=True, kw_only=True)
class LeakyPixels(Effect):
    """Charge that diffuses to the four neighbours before the taps: signal and background alike."""

    share: float
    kind = "pixel_crosstalk"

    def mixed(self, image: Array) -> Array:
        """An image (frame, row, col) after the leak; at its edge a pixel gives to itself."""
        wide = np.pad(image, ((0, 0), (1, 1), (1, 1)), mode="edge")
        near = wide[:, :-2, 1:-1] + wide[:, 2:, 1:-1] + wide[:, 1:-1, :-2] + wide[:, 1:-1, 2:]
        return np.asarray(image + np.float32(self.share) * (near - 4 * image))

    def light(self, x: Exposure) -> None:
        lit = ~x.empty
        shape = x.z.shape
        for start in range(0, shape[0], 25):
            part = slice(start, start + 25)
            z = self.mixed(x.image(x.z[part])).reshape(-1, shape[1])
            x.z[part] = np.where(lit[part], z, x.z[part])
            x.charge[part] = self.mixed(x.image(x.charge[part])).reshape(-1, shape[1])
