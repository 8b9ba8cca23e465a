"""Scenes drawn from a seed: what stands before the camera.

Each family is a function of a generator and the image; every scene's surfaces have names, and its `target` is the
surface that a mechanism of one surface acts on. Which kinds can be told from their rivals on which family is in
`blind.eligible`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from blind.geometry import Array, Beams, Surface, View, direction

TARGET = "panel"  # every scene has one surface of this name


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """A family's name and the surfaces that one seed gave."""

    family: str
    surfaces: list[Surface]


def _u(rng: np.random.Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 3)


def _backdrop(rng: np.random.Generator, range_mm: float, yaw: float = 0.0) -> Surface:
    return Surface(
        name="back wall",
        center_mm=(0.0, 0.0, range_mm),
        size_mm=(40000.0, 40000.0),
        yaw_deg=yaw,
        pitch_deg=_u(rng, -6, 6),
        reflectivity=_u(rng, 0.4, 0.8),
    )


def _panel(rng: np.random.Generator, side: float, away: float) -> Surface:
    """A slanted board at one side: its ranges and angles span enough to tell its own effects from a constant."""
    yaw = side * _u(rng, 42, 52)
    return Surface(
        name=TARGET,
        center_mm=(-side * 0.28 * away, _u(rng, -0.05, 0.05) * away, away),
        size_mm=(round(0.75 * away, 1), round(0.62 * away, 1)),
        yaw_deg=yaw,
        pitch_deg=_u(rng, -5, 5),
        reflectivity=_u(rng, 0.5, 0.8),
    )


def boards(rng: np.random.Generator) -> list[Surface]:
    """Boards at several distances before a wall, one of them slanted."""
    side = float(rng.choice([-1, 1]))
    return [
        _panel(rng, side, _u(rng, 2600, 3200)),
        Surface(
            name="near board",
            center_mm=(side * _u(rng, 350, 480), _u(rng, -500, -250), _u(rng, 1200, 1600)),
            size_mm=(_u(rng, 320, 480), _u(rng, 300, 460)),
            pitch_deg=_u(rng, -12, 12),
            reflectivity=_u(rng, 0.3, 0.9),
        ),
        Surface(
            name="middle board",
            center_mm=(side * _u(rng, 700, 1000), _u(rng, 300, 600), _u(rng, 3300, 3900)),
            size_mm=(_u(rng, 900, 1300), _u(rng, 800, 1200)),
            yaw_deg=_u(rng, -20, 20),
            reflectivity=_u(rng, 0.3, 0.9),
        ),
        _backdrop(rng, _u(rng, 4600, 5100), _u(rng, -6, 6)),
    ]


def slanted_wall(rng: np.random.Generator) -> list[Surface]:
    """One long wall aslant through the image, a board before it, a wall behind."""
    side = float(rng.choice([-1, 1]))
    return [
        Surface(
            name=TARGET,
            center_mm=(-side * 900.0, 0.0, _u(rng, 3000, 3400)),
            size_mm=(_u(rng, 4200, 4800), 9000.0),
            yaw_deg=side * _u(rng, 52, 60),
            pitch_deg=_u(rng, -4, 4),
            reflectivity=_u(rng, 0.5, 0.9),
        ),
        Surface(
            name="board",
            center_mm=(side * _u(rng, 250, 400), _u(rng, -200, 200), _u(rng, 1900, 2300)),
            size_mm=(_u(rng, 500, 700), _u(rng, 600, 900)),
            yaw_deg=_u(rng, -15, 15),
            reflectivity=_u(rng, 0.3, 0.9),
        ),
        _backdrop(rng, _u(rng, 4800, 5200)),
    ]


def corridor(rng: np.random.Generator) -> list[Surface]:
    """Two long walls, a floor, and an open end that nothing returns from; a door stands ajar."""
    half = _u(rng, 900, 1200)
    side = float(rng.choice([-1, 1]))
    return [
        Surface(
            name="left wall",
            center_mm=(-half, 0.0, 3200.0),
            size_mm=(6000.0, 6000.0),
            yaw_deg=-90.0 + _u(rng, -2, 2),
            reflectivity=_u(rng, 0.5, 0.9),
        ),
        Surface(
            name="right wall",
            center_mm=(half, 0.0, 3200.0),
            size_mm=(6000.0, 6000.0),
            yaw_deg=90.0 + _u(rng, -2, 2),
            reflectivity=_u(rng, 0.5, 0.9),
        ),
        Surface(
            name="floor",
            center_mm=(0.0, _u(rng, 900, 1200), 3200.0),
            size_mm=(6000.0, 6000.0),
            pitch_deg=90.0,
            reflectivity=_u(rng, 0.3, 0.6),
        ),
        Surface(
            name=TARGET,
            center_mm=(side * half * 0.35, 0.0, _u(rng, 2400, 3000)),
            size_mm=(_u(rng, 900, 1100), _u(rng, 1500, 1900)),
            yaw_deg=side * _u(rng, 38, 50),
            reflectivity=_u(rng, 0.5, 0.8),
        ),
    ]


def corner(rng: np.random.Generator) -> list[Surface]:
    """Two walls that meet, and a board before them."""
    turn, deep = _u(rng, -8, 8), _u(rng, 4200, 4800)
    return [
        Surface(
            name=TARGET,
            center_mm=(-1500.0, 0.0, deep - 1500.0),
            size_mm=(4600.0, 9000.0),
            yaw_deg=-45.0 + turn,
            reflectivity=_u(rng, 0.5, 0.9),
        ),
        Surface(
            name="right wall",
            center_mm=(1500.0, 0.0, deep - 1500.0),
            size_mm=(4600.0, 9000.0),
            yaw_deg=45.0 + turn,
            reflectivity=_u(rng, 0.4, 0.8),
        ),
        Surface(
            name="board",
            center_mm=(_u(rng, -200, 200), _u(rng, 100, 350), _u(rng, 1700, 2200)),
            size_mm=(_u(rng, 450, 650), _u(rng, 400, 600)),
            pitch_deg=_u(rng, -20, 20),
            reflectivity=_u(rng, 0.3, 0.9),
        ),
        _backdrop(rng, 6000.0),
    ]


def near_far(rng: np.random.Generator) -> list[Surface]:
    """A bright board near the camera, dark things far behind."""
    side = float(rng.choice([-1, 1]))
    return [
        Surface(
            name="bright board",
            center_mm=(side * _u(rng, 330, 400), 0.0, _u(rng, 850, 1050)),
            size_mm=(_u(rng, 520, 620), _u(rng, 700, 900)),
            yaw_deg=_u(rng, -15, 15),
            reflectivity=_u(rng, 0.8, 0.95),
        ),
        _panel(rng, side, _u(rng, 2700, 3300)),
        Surface(
            name="dark board",
            center_mm=(side * 300.0, _u(rng, -600, 600), _u(rng, 3800, 4200)),
            size_mm=(1300.0, 1100.0),
            pitch_deg=_u(rng, -10, 10),
            reflectivity=_u(rng, 0.08, 0.15),
        ),
        Surface(
            name="back wall",
            center_mm=(0.0, 0.0, _u(rng, 4700, 5200)),
            size_mm=(40000.0, 40000.0),
            reflectivity=_u(rng, 0.15, 0.3),
        ),
    ]


def stairs(rng: np.random.Generator) -> list[Surface]:
    """Upright strips, each farther than the one before; the middle one slanted."""
    side = float(rng.choice([-1, 1]))
    out = []
    for k, away in enumerate((1500.0, 2200.0, 3700.0, 4500.0)):
        depth = away * _u(rng, 0.94, 1.06)
        azimuth = side * (-0.42 + (0.17 * k if k < 2 else 0.24 + 0.17 * (k - 1)))
        out.append(
            Surface(
                name=f"strip {k + 1}",
                center_mm=(round(depth * float(np.tan(azimuth)), 1), 0.0, depth),
                size_mm=(round(0.17 * depth, 1), 9000.0),
                pitch_deg=_u(rng, -8, 8),
                reflectivity=_u(rng, 0.3, 0.9),
            )
        )
    away = _u(rng, 2700, 3200)
    out.append(
        Surface(
            name=TARGET,
            center_mm=(0.0, 0.0, away),
            size_mm=(round(0.42 * away, 1), 9000.0),
            yaw_deg=side * _u(rng, 42, 54),
            reflectivity=_u(rng, 0.5, 0.8),
        )
    )
    out.append(_backdrop(rng, _u(rng, 4900, 5200)))
    return out


def room(rng: np.random.Generator) -> list[Surface]:
    """A room from inside: side wall, floor, back wall, a cupboard and a bright screen."""
    side = float(rng.choice([-1, 1]))
    return [
        Surface(
            name=TARGET,
            center_mm=(-side * _u(rng, 1100, 1400), 0.0, 3000.0),
            size_mm=(8000.0, 8000.0),
            yaw_deg=side * _u(rng, 82, 90),
            reflectivity=_u(rng, 0.5, 0.9),
        ),
        Surface(
            name="floor",
            center_mm=(0.0, _u(rng, 1000, 1300), 3000.0),
            size_mm=(8000.0, 8000.0),
            pitch_deg=90.0 - _u(rng, 3, 9),
            reflectivity=_u(rng, 0.3, 0.6),
        ),
        Surface(
            name="cupboard",
            center_mm=(side * _u(rng, 900, 1200), _u(rng, 100, 300), _u(rng, 3000, 3500)),
            size_mm=(_u(rng, 900, 1200), _u(rng, 1200, 1600)),
            yaw_deg=_u(rng, -12, 12),
            reflectivity=_u(rng, 0.15, 0.4),
        ),
        Surface(
            name="screen",
            center_mm=(side * _u(rng, 100, 250), _u(rng, -350, -200), _u(rng, 1500, 1900)),
            size_mm=(_u(rng, 350, 500), _u(rng, 300, 400)),
            pitch_deg=_u(rng, -10, 10),
            reflectivity=_u(rng, 0.7, 0.95),
        ),
        _backdrop(rng, _u(rng, 4700, 5100), _u(rng, -4, 4)),
    ]


def open_hall(rng: np.random.Generator) -> list[Surface]:
    """Boards in the open: between and above them nothing returns."""
    side = float(rng.choice([-1, 1]))
    return [
        _panel(rng, side, _u(rng, 2500, 3000)),
        Surface(
            name="board",
            center_mm=(side * _u(rng, 500, 700), _u(rng, -400, 0), _u(rng, 2000, 2600)),
            size_mm=(_u(rng, 500, 800), _u(rng, 600, 900)),
            yaw_deg=_u(rng, -20, 20),
            reflectivity=_u(rng, 0.3, 0.9),
        ),
        Surface(
            name="far board",
            center_mm=(side * _u(rng, 300, 700), _u(rng, 500, 800), _u(rng, 4200, 4900)),
            size_mm=(_u(rng, 1600, 2200), _u(rng, 1100, 1600)),
            pitch_deg=_u(rng, -20, 20),
            reflectivity=_u(rng, 0.3, 0.9),
        ),
        Surface(
            name="ground",
            center_mm=(0.0, _u(rng, 1200, 1500), 3000.0),
            size_mm=(9000.0, 6000.0),
            pitch_deg=90.0,
            reflectivity=_u(rng, 0.3, 0.6),
        ),
    ]


def far_hall(rng: np.random.Generator) -> list[Surface]:
    """A hall whose end lies beyond a turn of the phase, with things before it."""
    side = float(rng.choice([-1, 1]))
    return [
        _panel(rng, side, _u(rng, 3000, 4000)),
        Surface(
            name="far wall",
            center_mm=(0.0, 0.0, _u(rng, 8150, 8450)),
            size_mm=(60000.0, 60000.0),
            yaw_deg=_u(rng, -5, 5),
            reflectivity=_u(rng, 0.5, 0.9),
        ),
        Surface(
            name="board",
            center_mm=(side * _u(rng, 800, 1300), _u(rng, -500, 500), _u(rng, 4500, 5500)),
            size_mm=(_u(rng, 1000, 1500), _u(rng, 900, 1300)),
            yaw_deg=_u(rng, -20, 20),
            reflectivity=_u(rng, 0.3, 0.9),
        ),
    ]


def far_gate(rng: np.random.Generator) -> list[Surface]:
    """A wall within a turn of the phase, and in it a gate through which a board beyond the turn is seen."""
    wall, gate, side = _u(rng, 5200, 6000), _u(rng, 0.03, 0.05), float(rng.choice([-1, 1]))
    half = round(gate * wall, 1)
    left, right = (
        Surface(name=name, center_mm=(sign * (20000.0 + half), 0.0, wall), size_mm=(40000.0, 60000.0), reflectivity=0.6)
        for name, sign in (("left wall", -1), ("right wall", 1))
    )
    return [
        _panel(rng, side, _u(rng, 3000, 4000)),
        left,
        right,
        Surface(
            name="board beyond",
            center_mm=(0.0, 0.0, _u(rng, 8200, 8600)),
            size_mm=(60000.0, 60000.0),
            pitch_deg=_u(rng, -8, 8),
            reflectivity=_u(rng, 0.5, 0.9),
        ),
    ]


def dark_and_bright(rng: np.random.Generator) -> list[Surface]:
    """A bright and a dark board side by side at like ranges, and a slanted one, before a dim wall."""
    side, away, above = float(rng.choice([-1, 1])), _u(rng, 1800, 2300), float(rng.choice([-1, 1]))
    return [
        _panel(rng, side, _u(rng, 2700, 3300)),
        Surface(
            name="bright board",
            center_mm=(side * 0.25 * away, above * 0.2 * away, away),
            size_mm=(_u(rng, 550, 750), _u(rng, 500, 700)),
            yaw_deg=_u(rng, -20, 20),
            reflectivity=_u(rng, 0.8, 0.95),
        ),
        Surface(
            name="dark board",
            center_mm=(side * 0.25 * away, -above * 0.2 * away, away * _u(rng, 0.95, 1.05)),
            size_mm=(_u(rng, 550, 750), _u(rng, 500, 700)),
            yaw_deg=_u(rng, -20, 20),
            reflectivity=_u(rng, 0.1, 0.16),
        ),
        Surface(
            name="back wall",
            center_mm=(0.0, 0.0, _u(rng, 4400, 4800)),
            size_mm=(40000.0, 40000.0),
            yaw_deg=_u(rng, -6, 6),
            reflectivity=_u(rng, 0.3, 0.45),
        ),
    ]


FAMILIES: dict[str, Callable[[np.random.Generator], list[Surface]]] = {
    "boards": boards,
    "slanted_wall": slanted_wall,
    "corridor": corridor,
    "corner": corner,
    "near_far": near_far,
    "stairs": stairs,
    "room": room,
    "open_hall": open_hall,
    "far_hall": far_hall,
    "far_gate": far_gate,
    "dark_and_bright": dark_and_bright,
}


def draw_scene(family: str, seed: list[int], view: View) -> Scene:
    """A scene of a family; drawn again until its target fills a tenth of the image and two other surfaces are seen."""
    from blind.geometry import cast

    rng = np.random.default_rng([*seed, 21])
    for _ in range(50):
        surfaces = FAMILIES[family](rng)
        beams = cast(surfaces, view)
        area = np.array([(beams.share * (beams.surface == k)).sum() for k in range(len(surfaces))]) / view.pixels
        target = [s.name for s in surfaces].index(TARGET)
        if area[target] > 0.1 and area[target] < 0.8 and (np.delete(area, target) > 0.02).sum() >= 2:
            return Scene(family=family, surfaces=surfaces)
    raise RuntimeError(f"{family}: no scene of seed {seed} shows its target")


def with_object(surfaces: list[Surface], view: View, seed: list[int]) -> list[Surface]:
    """The scene with a board more, which fills 5 to 15 % of the image and hides at most half of each other surface."""
    from blind.geometry import cast, first_hit

    rng = np.random.default_rng([*seed, 22])
    coarse = replace(view, rows=24, cols=32)
    whole = _areas(cast(surfaces, coarse), len(surfaces))
    wide, high = np.radians(view.fov_horizontal_deg), np.radians(view.fov_vertical_deg)
    for _ in range(200):
        azimuth, elevation = 0.35 * wide * rng.uniform(-1, 1), 0.35 * high * rng.uniform(-1, 1)
        number, behind, _ = first_hit(surfaces, np.array([azimuth]), np.array([elevation]), view.range_max_mm)
        away = float(rng.uniform(0.5, 0.8)) * (float(behind[0]) if number[0] >= 0 else 4000.0)
        side = away * np.sqrt(wide * high * rng.uniform(0.06, 0.14))
        shape = float(np.sqrt(rng.uniform(0.7, 1.4)))
        ray = direction(np.array(azimuth), np.array(elevation)) * away
        board = Surface(
            name="object",
            center_mm=(round(float(ray[0]), 1), round(float(ray[1]), 1), round(float(ray[2]), 1)),
            size_mm=(round(side * shape, 1), round(side / shape, 1)),
            yaw_deg=_u(rng, -25, 25),
            pitch_deg=_u(rng, -15, 15),
            reflectivity=_u(rng, 0.2, 0.9),
        )
        area = _areas(cast([*surfaces, board], coarse), len(surfaces) + 1)
        if 0.05 < area[-1] < 0.15 and (area[:-1] >= 0.5 * whole).all():
            return [*surfaces, board]
    raise RuntimeError(f"no place for an object of seed {seed}")


def _areas(beams: Beams, surfaces: int) -> Array:
    """Share (surface,) of the image that each surface fills."""
    filled = [(beams.share * (beams.surface == k)).sum() / beams.share.shape[1] for k in range(surfaces)]
    return np.array(filled)
