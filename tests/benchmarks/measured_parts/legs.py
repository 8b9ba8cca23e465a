"""Straight legs of a small drone before a wall, against their own first frames as the scene.

Nine legs of the five flights of `flights`. The drone flies before the leg begins, so no stand is its scene: the first
12 frames of each leg are, in which it moves already. The true speed is the slope of the distance to the wall over the
leg. Zones with eight valid samples in the reference and eight in the rest are compared.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from benchmarks.measured_parts.flights import VALID
from benchmarks.measured_parts.of_itself import of_itself
from benchmarks.real_recordings import FOLDER

from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of

LEGS = (
    ("A0", 115, 178),
    ("A0", 208, 274),
    ("A1", 95, 176),
    ("A2", 112, 158),
    ("A2", 312, 370),
    ("A3", 97, 180),
    ("A3", 232, 330),
    ("A4", 88, 148),
    ("A4", 196, 228),
)
"""Flight, first frame, and frame after the last."""

CASES = len(LEGS)
_REFERENCE, _LEAST = 12, 8  # frames of the scene; valid samples of a zone on both sides
_VIEW_DEG = 45.0
_NEAR, _ERRORS = 0.1, 2.0  # part of the speed, and stated errors, by which a right one may be off


def judged(number: int, seed: int) -> dict[str, Any] | None:  # noqa: ARG001  nothing is drawn
    """The result of one leg; None without the recordings."""
    flight, first, last = LEGS[number]
    path = FOLDER / "vl53l5cx_flights" / f"{flight}.npz"
    if not path.exists():
        return None
    data = np.load(path)
    depth = np.where(np.isin(data["status"], VALID), data["range_mm"].astype(np.float64), np.nan)[first:last]
    time_s, distance = data["time_s"][first:last], data["true_distance_mm"][first:last]
    seen = np.isfinite(depth)
    used = np.minimum(seen[:_REFERENCE].sum(axis=0), seen[_REFERENCE:].sum(axis=0)) >= _LEAST
    view = Equiangular(fov_horizontal_deg=_VIEW_DEG, fov_vertical_deg=_VIEW_DEG)
    ranges = np.where(used, depth, np.nan) / beam_directions_of(view, depth.shape[1:])[..., 2]
    found = of_itself(ranges, _REFERENCE, time_s - time_s[0], view_deg=_VIEW_DEG)
    speed = float(np.polyfit(time_s[_REFERENCE:], distance[_REFERENCE:], 1)[0])
    motion = next((e for e in found["effects"] if e["kind"] == "motion"), None)
    off = None if motion is None else motion["parameters"]["velocity_mm_s"] - speed
    error = None if motion is None else motion["stderr"].get("velocity_mm_s", 0.0)
    return {
        "number": number,
        "name": f"{flight}, {first} to {last}",
        "zones": int(used.sum()),
        "speed_mm_s": round(speed, 1),
        "off_mm_s": off,
        "error_mm_s": error,
        "near": off is not None and abs(off) <= _NEAR * abs(speed),
        "within": off is not None and error is not None and abs(off) <= _ERRORS * error,
        **found,
    }


def order(count: int) -> Sequence[int]:
    """The first legs."""
    return range(count)


def table(done: Sequence[Any]) -> Iterator[str]:
    """Each leg with its speed, true and found."""
    if not done:
        yield "Left out: the recordings are not on this machine; their licence does not let the project hold them."
        return
    yield "| leg, frames | zones | true speed, mm/s | found | verdict | besides |"
    yield "|---|---|---|---|---|---|"
    for line in done:
        motion = next((e for e in line["effects"] if e["kind"] == "motion"), None)
        value = "-" if motion is None else f"{line['speed_mm_s'] + line['off_mm_s']:.0f} +- {line['error_mm_s']:.0f}"
        others = ", ".join(kind for kind in line["named"] if kind != "motion") or "-"
        own = (line["name"], line["zones"], f"{line['speed_mm_s']:.0f}", value, line["verdict"], others)
        yield "| " + " | ".join(map(str, own)) + " |"
    yield ""
    near, within = (sum(line[key] for line in done) for key in ("near", "within"))
    yield f"Within 10 %: {near} of {len(done)} (aim 7 of 9); within two stated errors: {within} (aim 8)."
