"""From a kind and a strength to a mechanism: what `faint` and `clear` mean in physical parameters.

A strength is a pure number, so that it means the same on any device and scene: for biases in range their root mean
square in units of the local sigma, for others a share or a probability (`UNITS`).
"""

import math
from collections.abc import Callable

import numpy as np

from blind import effects as fx
from blind.effects import Effect, Place
from blind.geometry import Array
from blind.scenes import TARGET

Maker = Callable[[float, np.random.Generator, Place], Effect]

UNITS = {
    "range_offset": "offset, median sigma of the image",
    "surface_pose": "shift, median sigma on the board",
    "surface_offset": "bias, median sigma on the board",
    "wiggling": "amplitude, median sigma of the image",
    "tap_mismatch": "larger amplitude, median sigma of the image",
    "amplitude_walk": "root mean square bias, sigma",
    "temperature_drift": "final bias, median sigma of the image",
    "smooth_pattern": "root mean square bias, median sigma of the image",
    "fixed_pattern": "sigma of the pixels' delays, median sigma of the image",
    "scattering": "root mean square bias, sigma",
    "internal_reflection": "root mean square bias, sigma",
    "multipath": "bias, median sigma on the board",
    "phase_wrapping": "none: through a gate (faint), or the hall's end (clear)",
    "flying_pixels": "probability",
    "excess_noise": "factor - 1; of one board, times the root of its share of the image",
    "vignetting": "corner factor - 1",
    "near_return": "share of the samples",
    "outliers": "probability",
    "stuck_pixels": "share of the pixels",
    "dropout": "share of the samples lost",
    "temporal_correlation": "coefficient",
    "interference": "added sigma, median sigma of the image",
    "saturation": "share of the samples lost",
    "motion": "way in the whole recording, median sigma on the board",
    "quantisation": "step, lower decile of sigma",
    "pixel_crosstalk": "share",
}


def main_layers(place: Place) -> tuple[Array, Array, Array]:
    """Range, reflectivity times cosine, and surface (n,) of the surfaces that fill over half a beam."""
    main = place.beams.share > 0.5
    reflectivity = np.array([s.reflectivity for s in place.surfaces])
    surface = place.beams.surface[main]
    return place.beams.range_mm[main], reflectivity[surface] * place.beams.cosine[main], surface


def image_sigma(place: Place, quantile: float = 0.5) -> float:
    """Quantile of sigma over the image, mm."""
    return float(np.quantile(place.sigmas(), quantile))


def _target_sigma(place: Place) -> float:
    number = [s.name for s in place.surfaces].index(TARGET)
    return float(np.median(place.sigmas()[main_layers(place)[2] == number]))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _offset(size: float, rng: np.random.Generator, place: Place) -> Effect:
    return fx.CableDelay(delay_ps=_sign(rng) * size * image_sigma(place) / (0.0299792458 * 5))


def _pose(size: float, rng: np.random.Generator, place: Place) -> Effect:
    return fx.MisplacedBoard(surface=TARGET, shift_mm=_sign(rng) * size * _target_sigma(place))


def _wax(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    k = 2 * math.pi / place.device.unambiguous_mm
    return fx.WaxBoard(surface=TARGET, depth_mm=math.tan(k * size * _target_sigma(place)) / k)


def _wiggling(size: float, rng: np.random.Generator, place: Place) -> Effect:
    share = size * image_sigma(place) * 2 * math.pi / place.device.unambiguous_mm
    third, fifth = rng.uniform(0, 2 * math.pi, 2)
    sum_of_both = abs(-np.exp(1j * third) + 0.25 * np.exp(1j * fifth))
    return fx.Harmonics(
        third=share / sum_of_both, third_phase=float(third), fifth=0.25 * share / sum_of_both, fifth_phase=float(fifth)
    )


def _unequal(size: float, rng: np.random.Generator, place: Place) -> Effect:
    """Of the gain, of two periods; the imbalance, of one period, is a third of it."""
    radians = size * image_sigma(place) * 2 * math.pi / place.device.unambiguous_mm
    imbalance = radians / 3 * np.exp(1j * float(rng.uniform(0, 2 * math.pi)))
    return fx.UnequalTaps(gain=2 * radians, common=complex(imbalance), clock_rad=float(rng.uniform(0, math.pi)))


def _walk(size: float, rng: np.random.Generator, place: Place) -> Effect:
    knee = float(np.quantile(place.amplitudes(), 0.1)) * float(rng.uniform(0.1, 0.3))
    unit = fx.ChargeLag(late_mm=1.0, knee_amplitude=knee)
    relative = unit.bias(place.amplitudes()) / place.sigmas()
    return fx.ChargeLag(late_mm=size / float(np.sqrt((relative**2).mean())), knee_amplitude=knee)


def _drift(size: float, rng: np.random.Generator, place: Place) -> Effect:
    rise = float(rng.uniform(8, 20))
    seconds = place.device.frames / place.device.frame_rate_hz
    return fx.WarmUp(
        delay_mm_per_kelvin=_sign(rng) * size * image_sigma(place) / rise,
        rise_kelvin=rise,
        time_constant_s=seconds * float(rng.uniform(0.2, 0.5)),
    )


def _feed(size: float, rng: np.random.Generator, place: Place) -> Effect:
    along = str(rng.choice(["across", "down"]))
    unit = float(np.sqrt((fx.FeedLine(rc_mm=1.0, along=along).map(place.device) ** 2).mean()))
    return fx.FeedLine(rc_mm=_sign(rng) * size * image_sigma(place) / unit, along=along)


def _pattern(size: float, rng: np.random.Generator, place: Place) -> Effect:
    pixel = size * image_sigma(place)
    return fx.DelayLines(pixel_mm=pixel, column_mm=0.5 * pixel, row_mm=0.35 * pixel, wafer=int(rng.integers(2**31)))


def _stray(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    range_mm, gloss, _ = main_layers(place)
    device = place.device
    z = device.amplitude(range_mm, gloss) * device.phasor(range_mm)
    veil = z.sum() / device.view.pixels
    bias = device.unambiguous_mm / (2 * math.pi) * (veil / z).imag
    return fx.StrayLight(share=size / float(np.sqrt(((bias / place.sigmas()) ** 2).mean())))


def _glare(size: float, rng: np.random.Generator, place: Place) -> Effect:
    """From a window some cm before the lens; so small that the bias is in proportion to it."""
    way_mm = float(rng.uniform(10, 120))
    range_mm, gloss, _ = main_layers(place)
    device = place.device
    z = device.amplitude(range_mm, gloss) * device.phasor(range_mm)
    bias = device.unambiguous_mm / (2 * math.pi) * (device.phasor(np.array(way_mm / 2)) / z).imag
    electrons = size / float(np.sqrt(((bias / place.sigmas()) ** 2).mean()))
    return fx.WindowGlare(glare_electrons=electrons, way_mm=way_mm)


def _echo(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    return fx.WindowEcho(share_of_shots=size, gap_mm=float(rng.uniform(15, 60)), jitter_ps=float(rng.uniform(15, 60)))


def _bounce(size: float, rng: np.random.Generator, place: Place) -> Effect:
    extra = float(rng.uniform(700, 2400))
    turn = math.pi * extra / place.device.unambiguous_mm
    bias = size * _target_sigma(place) * 2 * math.pi / place.device.unambiguous_mm
    share = math.tan(bias) / (math.sin(turn) - math.tan(bias) * math.cos(turn))
    return fx.SecondBounce(surface=TARGET, share=share, extra_path_mm=extra)


def _fold(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    return fx.OneFrequency()


def _flying(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    return fx.WholeBeam(probability=min(size, 1.0))


def _ambient(size: float, rng: np.random.Generator, place: Place) -> Effect:
    """More light everywhere, or on one board: there by as much more as fewer pixels show it."""
    if rng.random() < 0.5:
        return fx.AmbientLight(times=(1 + size) ** 2)
    of = main_layers(place)[2] == [s.name for s in place.surfaces].index(TARGET)
    return fx.SunOnBoard(surface=TARGET, times=(1 + size / math.sqrt(float(of.mean()))) ** 2)


def _falling(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    corner = float(fx.FallingIllumination.axis_cosine(place.device).min())
    return fx.FallingIllumination(power=-math.log(1 + size) / math.log(corner))


def _wild(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    return fx.WildValues(probability=size)


def _dead(size: float, rng: np.random.Generator, place: Place) -> Effect:
    value = float(round(rng.uniform(place.device.range_min_mm, place.device.range_max_mm)))
    return fx.DeadTaps(share=size, value_mm=value, wafer=int(rng.integers(2**31)))


def _lost(size: float, rng: np.random.Generator, place: Place) -> Effect:
    """Packets only, the comparator only, or both half and half."""
    packets = float(rng.choice([0.0, 0.5, 1.0]))
    if packets == 1.0:
        return fx.LostSamples(packet_loss=size, threshold=0.0, comparator_noise=0.0)
    return fx.LostSamples(packet_loss=size * packets, **_comparator(size * (1 - packets), place))


def _comparator(share: float, place: Place) -> dict[str, float]:
    """The threshold at which so many samples are lost, with a comparator noise of 8 % of it."""
    from scipy.special import ndtr

    amplitude = place.amplitudes()
    own = amplitude * place.sigmas() * 2 * math.pi / place.device.unambiguous_mm
    low, high = 0.0, float(amplitude.max())
    for _ in range(60):
        middle = (low + high) / 2
        lost = ndtr((middle - amplitude) / np.hypot(own, 0.08 * middle)).sum() / place.device.view.pixels
        low, high = (middle, high) if lost < share else (low, middle)
    return {"threshold": low, "comparator_noise": 0.08 * low}


def _memory(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    return fx.Memory(coefficient=min(size, 0.95))


def _second_camera(size: float, rng: np.random.Generator, place: Place) -> Effect:
    sigma = size * image_sigma(place)
    strength = sigma * 2 * math.pi / place.device.unambiguous_mm * math.sqrt(2)
    return fx.SecondCamera(strength=strength, share_of_frames=float(rng.uniform(0.12, 0.3)), burst_frames=5)


def _full(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    amplitude = np.sort(place.amplitudes())
    last = max(amplitude.size - max(1, round(size * place.device.view.pixels)), 1)
    return fx.FullWell(capacity_electrons=float(amplitude[last - 1 : last + 1].mean()) / place.device.amplitude_unit)


def _moving(size: float, rng: np.random.Generator, place: Place) -> Effect:
    seconds = place.device.frames / place.device.frame_rate_hz
    return fx.MovingBoard(surface=TARGET, velocity_mm_s=_sign(rng) * size * _target_sigma(place) / seconds)


def _coarse(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    return fx.CoarsePhase(levels=round(place.device.unambiguous_mm / (size * image_sigma(place, 0.1))))


def _leaky(size: float, rng: np.random.Generator, place: Place) -> Effect:  # noqa: ARG001
    return fx.LeakyPixels(share=size)


MAKERS: dict[str, Maker] = {
    "range_offset": _offset,
    "surface_pose": _pose,
    "surface_offset": _wax,
    "wiggling": _wiggling,
    "tap_mismatch": _unequal,
    "amplitude_walk": _walk,
    "temperature_drift": _drift,
    "smooth_pattern": _feed,
    "fixed_pattern": _pattern,
    "scattering": _stray,
    "internal_reflection": _glare,
    "multipath": _bounce,
    "phase_wrapping": _fold,
    "flying_pixels": _flying,
    "excess_noise": _ambient,
    "vignetting": _falling,
    "near_return": _echo,
    "outliers": _wild,
    "stuck_pixels": _dead,
    "dropout": _lost,
    "temporal_correlation": _memory,
    "interference": _second_camera,
    "saturation": _full,
    "motion": _moving,
    "quantisation": _coarse,
    "pixel_crosstalk": _leaky,
}
KINDS = tuple(MAKERS)

NO_BLIND_TWIN: dict[str, str] = {}
"""Kinds of the package that this bench does not have, each with the reason; empty today."""


def make(kind: str, size: float, rng: np.random.Generator, place: Place) -> Effect:
    """A mechanism of a kind and a strength on a device and a scene."""
    return MAKERS[kind](size, rng, place)
