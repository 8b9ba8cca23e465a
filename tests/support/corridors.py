"""Corridors with a side exit, drawn from a seed, and a planner: for the benchmark of the maps and their pictures.

A robot stands at the head of a corridor; its camera looks along it, a little down. In one of the side walls is an
opening to a passage: the exit. From the camera, the wall's edge stands before the passage's far side, so pixels along
that edge see both. The exit is open, or truly blocked: by a closed door in the opening, or by a barrier across the
corridor before it.
"""

from collections import deque
from dataclasses import dataclass, replace
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from tofmix.mapping.occupancy import FloorMap, State
from tofmix.sensors import load_profile
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

Bools = NDArray[np.bool_]

ROBOT_RADIUS_MM = 250.0
ROBOT_HEIGHT_MM = 900.0
GROUND_CLEARANCE_MM = 100.0
CEILING_MM = 2500.0
PASSAGE_MM = 1500.0
GOAL_MM = 900.0
"""How far behind the opening the goal lies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Corridor:
    """A corridor in the level frame of its camera: x right, y down, z forward, mm.

    `side` is -1 where the exit is on the left, 1 on the right; the opening spans `opening_mm` along z.
    """

    model: Model
    pitch_deg: float
    camera_mm: float
    width_mm: float
    side: int
    opening_mm: tuple[float, float]
    end_mm: float
    blocked_by: str

    @property
    def height_mm(self) -> tuple[float, float]:
        """The robot's band of heights above the camera: from its ground clearance to its top."""
        return GROUND_CLEARANCE_MM - self.camera_mm, ROBOT_HEIGHT_MM - self.camera_mm

    @property
    def goal_mm(self) -> tuple[float, float]:
        """The goal in the map: x ahead, y to the left."""
        return sum(self.opening_mm) / 2, -self.side * (self.width_mm / 2 + GOAL_MM)

    def inside(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> Bools:
        """Whether places of the map (x ahead, y left) lie between the corridor's or the passage's walls."""
        across = -self.side * y_mm
        corridor = (np.abs(across) < self.width_mm / 2) & (x_mm > -ROBOT_RADIUS_MM - 200.0) & (x_mm < self.end_mm)
        near, far = self.opening_mm
        passage = (across > 0) & (across < self.width_mm / 2 + PASSAGE_MM) & (x_mm > near) & (x_mm < far)
        return np.asarray(corridor | passage)


def draw_corridor(seed: int, *, blocked: bool) -> Corridor:
    """Draw a corridor; the same seed gives the same one."""
    rng = np.random.default_rng([8, seed, blocked])
    width, camera, pitch = rng.uniform(1600.0, 2400.0), rng.uniform(600.0, 900.0), rng.uniform(4.0, 9.0)
    side = int(rng.choice([-1, 1]))
    near = 1.4 * width + rng.uniform(0.0, 900.0)
    far = near + rng.uniform(800.0, 1100.0)
    end = rng.uniform(far + 500.0, 6500.0) if rng.random() < 0.5 else 9000.0
    boards = _walls(width, side, (near, far), end, camera)
    blocked_by = str(rng.choice(["door", "barrier"])) if blocked else ""
    if blocked_by == "door":
        place = side * width / 2, camera - 1000.0, (near + far) / 2
        boards.append(("door", place, (far - near, 2000.0), 90.0))
    elif blocked_by == "barrier":
        height, z = rng.uniform(400.0, 1500.0), rng.uniform(2000.0, near - 200.0)
        boards.append(("barrier", (rng.uniform(-50.0, 50.0), camera - height / 2, z), (width - 200.0, height), 0.0))
    boards += _obstacles(rng, width, side, (near, far), camera)
    surfaces = [
        _pitched(
            Surface(
                name=name,
                center_mm=centre,
                size_mm=size,
                yaw_deg=0.0 if yaw == _LYING else yaw,
                pitch_deg=90.0 if yaw == _LYING else 0.0,
                reflectivity=rng.uniform(0.2, 0.9),
            ),
            pitch,
        )
        for name, centre, size, yaw in boards
    ]
    return Corridor(
        model=Model(sensor=_camera(), surfaces=tuple(surfaces)),
        pitch_deg=pitch,
        camera_mm=camera,
        width_mm=width,
        side=side,
        opening_mm=(near, far),
        end_mm=end,
        blocked_by=blocked_by,
    )


_LYING = -1.0  # in place of a yaw: floor and ceiling
_Board = tuple[str, tuple[float, float, float], tuple[float, float], float]


def _camera() -> CompleteCamera:
    return replace(load_profile("sr3000"), integration_time_ms=1.2)


def _walls(width: float, side: int, opening: tuple[float, float], end: float, camera: float) -> list[_Board]:
    """Walls, floor and ceiling. Lengths run along the wall."""
    near, far = opening
    middle, high, half = camera - CEILING_MM / 2, CEILING_MM, width / 2
    beyond = side * (half + PASSAGE_MM / 2)
    walls: list[_Board] = [
        ("wall before the exit", (side * half, middle, near / 2), (near, high), 90.0),
        ("wall behind the exit", (side * half, middle, (far + end) / 2), (end - far, high), 90.0),
        ("wall opposite", (-side * half, middle, end / 2), (end, high), 90.0),
        ("passage, near side", (beyond, middle, near), (PASSAGE_MM, high), 0.0),
        ("passage, far side", (beyond, middle, far), (PASSAGE_MM, high), 0.0),
        ("passage, end", (side * (half + PASSAGE_MM), middle, (near + far) / 2), (far - near, high), 90.0),
        ("floor", (0.0, camera, end / 2), (width, end), _LYING),
        ("ceiling", (0.0, camera - CEILING_MM, end / 2), (width, end), _LYING),
        ("floor of the passage", (beyond, camera, (near + far) / 2), (PASSAGE_MM, far - near), _LYING),
        ("ceiling of the passage", (beyond, camera - CEILING_MM, (near + far) / 2), (PASSAGE_MM, far - near), _LYING),
    ]
    return [*walls, ("end wall", (0.0, middle, end), (width, high), 0.0)] if end < 7000.0 else walls


def _obstacles(
    rng: np.random.Generator, width: float, side: int, opening: tuple[float, float], camera: float
) -> list[_Board]:
    """Boards standing about, along the wall opposite the exit, where they leave the robot its way."""
    out: list[_Board] = []
    for number in range(int(rng.integers(1, 4))):
        room = width - 2 * ROBOT_RADIUS_MM - 400.0
        size = rng.uniform(150.0, min(600.0, 0.6 * room)), rng.uniform(300.0, 1800.0)
        across = rng.uniform(width / 2 - room + size[0] / 2, width / 2 - size[0] / 2)
        place = -side * across, camera - size[1] / 2, rng.uniform(1800.0, opening[1] + 800.0)
        out.append((f"board {number}", place, size, rng.uniform(-30.0, 30.0)))
    return out


def _pitched(surface: Surface, pitch_deg: float) -> Surface:
    """The surface as a camera sees it that looks down by `pitch_deg`."""
    x, y, z = surface.center_mm
    c, s = cos(radians(pitch_deg)), sin(radians(pitch_deg))
    return replace(surface, center_mm=(x, c * y - s * z, s * y + c * z), pitch_deg=surface.pitch_deg + pitch_deg)


def find_way(map_: FloorMap, corridor: Corridor, *, radius_mm: float = ROBOT_RADIUS_MM) -> list[tuple[int, int]]:
    """Shortest way of the robot's centre, in steps to neighbouring cells; empty if there is none.

    Unknown cells may be crossed, as by ROS's planners by default (`allow_unknown`); the walls that the camera does
    not see, beside and behind it, are given.
    """
    x, y = map_.centres_mm(0), map_.centres_mm(1)
    clear = (map_.cells != State.OCCUPIED) & corridor.inside(x[:, None], y[None, :])
    clear = distance_transform_edt(np.pad(clear, 1, constant_values=True))[1:-1, 1:-1] * map_.cell_mm > radius_mm
    start, goal = (
        tuple(int((place[axis] - map_.origin_mm[axis]) // map_.cell_mm) for axis in (0, 1))
        for place in ((0.0, 0.0), corridor.goal_mm)
    )
    came: dict[tuple[int, ...], tuple[int, ...]] = {start: start}
    queue = deque([start])
    while queue and goal not in came:
        i, j = queue.popleft()
        for cell in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
            if cell not in came and min(cell) >= 0 and cell[0] < len(x) and cell[1] < len(y) and clear[cell]:
                came[cell] = (i, j)
                queue.append(cell)
    way = [goal] if goal in came else []
    while way and way[-1] != start:
        way.append(came[way[-1]])
    return [(cell[0], cell[1]) for cell in way[::-1]]
