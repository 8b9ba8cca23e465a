"""Rooms, corridors and alcoves, drawn: side walls, floors and ceilings that a camera sees at grazing angles."""

from collections.abc import Callable, Mapping

import numpy as np

from tofmix.simulation.surface import Surface

_Draw = np.random.Generator


def _uniform(rng: _Draw, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 1)


def _facing(rng: _Draw, name: str, center: tuple[float, float, float], size: tuple[float, float]) -> Surface:
    return Surface(name=name, center_mm=center, size_mm=size, reflectivity=_uniform(rng, 0.4, 0.9))


def _box_of_walls(
    rng: _Draw, left: float, right: float, depth: float, height: float, down: float
) -> tuple[Surface, ...]:
    """Walls at x = -left and x = right, an end at z = depth, a floor at y = down and a ceiling, all mm."""
    begin = 300.0  # before the camera's shortest range
    length, middle = depth - begin, 0.5 * (depth + begin)
    width, across, up = left + right, 0.5 * (right - left), height - down
    mean = 0.5 * (down - up)

    def side(name: str, x: float, yaw: float) -> Surface:
        return Surface(
            name=name,
            center_mm=(x, mean, middle),
            size_mm=(length, height),
            yaw_deg=yaw,
            reflectivity=_uniform(rng, 0.4, 0.9),
        )

    def level(name: str, y: float, pitch: float) -> Surface:
        return Surface(
            name=name,
            center_mm=(across, y, middle),
            size_mm=(width, length),
            pitch_deg=pitch,
            reflectivity=_uniform(rng, 0.3, 0.8),
        )

    return (
        _facing(rng, "back wall", (across, mean, depth), (width, height)),
        side("left wall", -left, 90.0),
        side("right wall", right, -90.0),
        level("floor", down, 90.0),
        level("ceiling", -up, -90.0),
    )


def room(rng: _Draw) -> tuple[Surface, ...]:
    """A back wall 3 to 6 m away, two side walls, a floor and a ceiling."""
    return _box_of_walls(
        rng,
        _uniform(rng, 900, 1700),
        _uniform(rng, 900, 1700),
        _uniform(rng, 3000, 6000),
        _uniform(rng, 2300, 2800),
        _uniform(rng, 900, 1500),
    )


def corridor(rng: _Draw) -> tuple[Surface, ...]:
    """Two long walls 1.2 to 2.5 m apart, and an end at 4 to 7 m."""
    apart = _uniform(rng, 1200, 2500)
    left = round(apart * float(rng.uniform(0.35, 0.65)), 1)
    walls = _box_of_walls(rng, left, apart - left, _uniform(rng, 4000, 7000), 2600.0, 1300.0)
    return walls[:3]


def alcove(rng: _Draw) -> tuple[Surface, ...]:
    """A wall with a box of 0.3 to 1 m behind an opening in it."""
    away, deep = _uniform(rng, 1800, 2600), _uniform(rng, 300, 1000)
    wide, high = _uniform(rng, 700, 1100), _uniform(rng, 600, 900)
    x, y = _uniform(rng, -200, 200), _uniform(rng, -150, 150)
    far = 2500.0  # half of the wall
    wall = _uniform(rng, 0.4, 0.9)

    def part(name: str, center: tuple[float, float], size: tuple[float, float]) -> Surface:
        return Surface(name=name, center_mm=(*center, away), size_mm=size, reflectivity=wall)

    def inner(name: str, at: tuple[float, float], length: tuple[float, float], yaw: float, pitch: float) -> Surface:
        return Surface(
            name=name,
            center_mm=(*at, away + 0.5 * deep),
            size_mm=length,
            yaw_deg=yaw,
            pitch_deg=pitch,
            reflectivity=_uniform(rng, 0.4, 0.9),
        )

    left, right, top, bottom = x - 0.5 * wide, x + 0.5 * wide, y - 0.5 * high, y + 0.5 * high
    return (
        part("left of it", (0.5 * (left - far), 0.0), (left + far, 2 * far)),
        part("right of it", (0.5 * (right + far), 0.0), (far - right, 2 * far)),
        part("above it", (x, 0.5 * (top - far)), (wide, top + far)),
        part("below it", (x, 0.5 * (bottom + far)), (wide, far - bottom)),
        _facing(rng, "its back", (x, y, away + deep), (wide, high)),
        inner("its left side", (left, y), (deep, high), 90.0, 0.0),
        inner("its right side", (right, y), (deep, high), -90.0, 0.0),
        inner("its floor", (x, bottom), (wide, deep), 0.0, 90.0),
        inner("its ceiling", (x, top), (wide, deep), 0.0, -90.0),
    )


ROOMS: Mapping[str, Callable[[_Draw], tuple[Surface, ...]]] = {"room": room, "corridor": corridor, "alcove": alcove}
