"""What a reconciliation said, against the truth: names, verdict, parameters.

Use `judge` on a parsed `gap.json`. Parameters count as right within 3 standard errors or 5 %; laws that differ from the
mechanism's (charge lag, comparator, full well) are compared as curves over the image's amplitudes, waves and second
bounces as phasors, maps as maps.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from blind.cases import Built
from blind.effects import Effect, Place
from blind.geometry import Array

Parameters = dict[str, Any]
SHARE = 0.05
ERRORS = 3.0


def judge(gap: dict[str, Any], built: Built, folder: Path) -> dict[str, Any]:
    """Names, verdict, place and parameters of a reconciliation.

    `gap`: the parsed `gap.json`.
    `built`: the case.
    `folder`: the reconciliation's folder, for maps.
    """
    named = [str(e["kind"]) for e in gap.get("effects", [])]
    truth = built.truth()
    out: dict[str, Any] = {
        "verdict": gap.get("verdict"),
        "named": named,
        "right": sorted(named) == sorted(truth["kinds"]),
        "first": bool(named) and named[0] in truth["kinds"],
        "found": sorted(set(named) & set(truth["kinds"])),
        "wrong": sorted(set(named) - set(truth["kinds"])),
        "where": [{"axis": w.get("axis"), "statistic": w.get("statistic")} for w in gap.get("where", [])[:3]],
    }
    if "stranger" in truth:
        out["axis_right"] = bool(out["where"]) and out["where"][0]["axis"] in truth["stranger"]["axes"]
    place = built.place()
    out["parameters"] = {}
    for effect, mechanism in zip(truth["effects"], built.mechanisms, strict=False):
        match = next((e for e in gap.get("effects", []) if e["kind"] == effect["kind"]), None)
        if match is not None and isinstance(mechanism, Effect):
            out["parameters"][effect["kind"]] = compare_parameters(
                mechanism, effect["parameters"], match, place, folder
            )
    return out


def compare_parameters(
    mechanism: Effect, truth: Parameters, named: dict[str, Any], place: Place, folder: Path
) -> dict[str, Any]:
    """Whether an effect's parameters are right, and how far off they are, as a share of the truth."""
    match = _Match(
        mechanism=mechanism,
        truth=truth,
        found=dict(named.get("parameters", {})),
        errors=dict(named.get("stderr", {}) or {}),
        place=place,
        folder=folder,
    )
    try:
        ok, off = _RULES.get(mechanism.kind, _plain)(match)
    except (KeyError, TypeError, ValueError, OSError) as error:
        return {"right": False, "off": None, "why": f"{type(error).__name__}: {error}"}
    return {"right": bool(ok), "off": float(off)}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Match:
    """A hidden effect and the one of its kind that was named."""

    mechanism: Effect
    truth: Parameters
    found: Parameters
    errors: Parameters
    place: Place
    folder: Path


def _near(truth: float, found: float, error: float | None) -> tuple[bool, float]:
    off = abs(float(found) - truth)
    return off <= max(SHARE * abs(truth), ERRORS * float(error or 0.0)), off / max(abs(truth), 1e-12)


def _plain(m: _Match) -> tuple[bool, float]:
    ok, worst = True, 0.0
    for name, value in m.truth.items():
        if name == "burst_frames":  # few bursts a recording: what their mean length is, is not a number of the m.truth
            continue
        if isinstance(value, str):
            ok &= m.found[name] == value
            continue
        good, off = _near(value, m.found[name], m.errors.get(name))
        ok, worst = ok and good, max(worst, off)
    return ok, worst


def _wave(m: _Match) -> tuple[bool, float]:
    size = m.truth["amplitude_mm"]
    good, off = _near(size, m.found["amplitude_mm"], m.errors.get("amplitude_mm"))
    turn = abs(math.remainder(m.found["phase_rad"] - m.truth["phase_rad"], 2 * math.pi))
    good_turn = turn <= max(SHARE, ERRORS * float(m.errors.get("phase_rad") or 0.0))
    if m.found["amplitude_mm"] < 0:
        return False, 2.0
    return good and good_turn, max(off, turn)


def _bounce(m: _Match) -> tuple[bool, float]:
    ok, off = _plain(m)

    def phasor(p: Parameters) -> complex:
        return complex(p["share"] * np.exp(1j * np.pi * p["extra_path_mm"] / m.place.device.unambiguous_mm))

    apart = abs(phasor(m.found) - phasor(m.truth)) / abs(phasor(m.truth))
    return m.found["surface"] == m.truth["surface"] and (ok or apart <= SHARE), min(off, apart)


def _lag(m: _Match) -> tuple[bool, float]:
    """As curves over the image, in units of sigma: the lag, or the power law nearest to it, and what is found."""
    amplitude, sigma = m.place.amplitudes(), m.place.sigmas()
    lag, curve = (
        p["scale_mm"] * (p["reference_amplitude"] / (amplitude + p.get("saturation_amplitude", 0.0))) ** p["exponent"]
        for p in (m.truth, m.found)
    )
    either = lag / sigma, _nearest_power(lag / sigma, amplitude, sigma)
    off = min(float(np.sqrt(((curve / sigma - wanted) ** 2).mean() / (wanted**2).mean())) for wanted in either)
    slack = ERRORS * float(m.errors.get("scale_mm") or 0.0) / max(abs(m.found["scale_mm"]), 1e-9)
    return off <= max(SHARE, slack), off


def _nearest_power(wanted: Array, amplitude: Array, sigma: Array) -> Array:
    """The power of amplitude, in units of sigma, nearest to a bias in these units, each pixel as known as its sigma."""
    ratio, best, found = float(np.exp(np.log(amplitude).mean())) / amplitude, np.inf, wanted
    for exponent in np.linspace(0.2, 1.2, 501):
        power = ratio**exponent / sigma
        fit = power * float(power @ wanted / (power @ power))
        error = float(((wanted - fit) ** 2).sum())
        if error < best:
            best, found = error, np.asarray(fit)
    return found


def _taps(m: _Match) -> tuple[bool, float]:
    """Each sine as a phasor; a sine that is less than the other's tolerance may be missing."""
    whole = max(m.truth["amplitude_1_mm"], m.truth["amplitude_2_mm"])
    ok, worst = True, 0.0
    for number in (1, 2):
        size, phase = f"amplitude_{number}_mm", f"phase_{number}_rad"
        wanted, found = (p.get(size, 0.0) * np.exp(1j * p.get(phase, 0.0)) for p in (m.truth, m.found))
        error = math.hypot(float(m.errors.get(size) or 0.0), abs(found) * float(m.errors.get(phase) or 0.0))
        ok &= bool(abs(found - wanted) <= max(SHARE * whole, ERRORS * error))
        worst = max(worst, abs(found - wanted) / whole)
    return ok, worst


def _lost_share(p: Parameters, amplitude: Array) -> Array:
    noise = max(float(p.get("threshold_noise", 0.0)), 1e-9)
    weak = ndtr((float(p.get("threshold", 0.0)) - amplitude) / noise) if p.get("threshold", 0.0) > 0 else 0.0
    chance = float(p.get("probability", 0.0))
    return np.asarray(chance + (1 - chance) * weak * np.ones_like(amplitude))


def _losses(m: _Match) -> tuple[bool, float]:
    amplitude = m.place.amplitudes()
    wanted, curve = _lost_share(m.truth, amplitude), _lost_share(m.found, amplitude)
    count = wanted.sum() * m.place.device.frames  # losses in the recording, and so how well their share can be known
    off = float(np.abs(curve - wanted).sum() / wanted.sum())
    return off <= max(2 * SHARE, ERRORS * 2 / math.sqrt(max(count, 1.0))), off


def _of_its_surface(m: _Match) -> tuple[bool, float]:
    ok, off = _plain(m)
    return ok and m.found.get("surface") == m.truth.get("surface"), off


def _well(m: _Match) -> tuple[bool, float]:
    amplitude = m.place.amplitudes()
    full = [(amplitude > p["full_well_amplitude"]).sum() for p in (m.truth, m.found)]
    off = abs(float(full[1]) - float(full[0])) / max(float(full[0]), 1.0)
    near = _near(m.truth["full_well_amplitude"], m.found["full_well_amplitude"], m.errors.get("full_well_amplitude"))[0]
    return near or off <= SHARE, off


def _map(m: _Match) -> tuple[bool, float]:
    if "map" not in m.found:
        return _plain(m)
    device = m.place.device
    wanted = m.mechanism.map(device)
    seen = np.load(m.folder / m.found["map"], allow_pickle=False).astype(float)
    assert wanted is not None
    if m.mechanism.kind == "stuck_pixels":
        same = np.isfinite(seen) == np.isfinite(wanted)
        both = np.isfinite(seen) & np.isfinite(wanted)
        off = 1.0 - float(same.mean()) + float(not np.allclose(seen[both], wanted[both], atol=1.0))
        return off == 0, off
    main = (m.place.beams.share[0] > 0.99).reshape(wanted.shape)
    rest = (seen - wanted)[main] - (seen - wanted)[main].mean()
    noise = m.place.sigma_map()[0].reshape(wanted.shape)[main] / math.sqrt(device.frames)
    off = float(np.sqrt((rest**2).mean() / (wanted[main] ** 2).mean()))
    return off <= max(SHARE, 1.3 * float(np.sqrt((noise**2).mean() / (wanted[main] ** 2).mean()))), off


_Rule = Callable[[_Match], tuple[bool, float]]
_RULES: dict[str, _Rule] = {
    "wiggling": _wave,
    "tap_mismatch": _taps,
    "multipath": _bounce,
    "excess_noise": _of_its_surface,
    "surface_offset": _of_its_surface,
    "amplitude_walk": _lag,
    "dropout": _losses,
    "saturation": _well,
    "fixed_pattern": _map,
    "stuck_pixels": _map,
}
