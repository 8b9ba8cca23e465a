"""A camera in a line, for recordings of arrays."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tofmix.sensor import NoiseCurve, Sensor


def camera_of(
    range_mm: ArrayLike,
    sigma_mm: ArrayLike,
    *law: Any,  # noqa: ANN401  of NoiseCurve
    reach_mm: tuple[float | None, float | None] = (None, None),
    fov_deg: tuple[float | None, float | None] = (None, None),
    **others: Any,  # noqa: ANN401  of Sensor
) -> Sensor:
    """A camera with a noise curve; `reach_mm`: its working range; `fov_deg`: its fields of view, horizontal first."""
    curve = NoiseCurve(np.array(range_mm, dtype=np.float64), np.array(sigma_mm, dtype=np.float64), *law)
    (low, high), (wide, tall) = reach_mm, fov_deg
    reach = {"range_min_mm": low, "range_max_mm": high, "fov_horizontal_deg": wide, "fov_vertical_deg": tall}
    return Sensor(**{"name": "a camera", "noise": curve, **reach, **others})
