"""Near return: a nearest layer at nearly one range in nearly every pixel, with other things behind it.

A cover glass or the housing sends light back on the same short way to all pixels. Farther away, one range in every
pixel is a surface that all see through, such as a net.
"""

import math

import numpy as np

from tofmix.arrays import BoolArray
from tofmix.suspicion.frame_kinds import LEAST_SHARE, NOISE_SIGMAS
from tofmix.suspicion.scene import LEAST_PIXELS, Suspicion, WindowScene


def mark_near_return(scene: WindowScene) -> BoolArray:
    """Layers (row, col, layer) that are the near return, or none.

    Pixels whose layers lie at one range by chance do so one by one: the share of pixels that have it must be above
    one half beyond the chance `FALSE_MARKS`, which takes nine pixels.
    """
    marked = np.zeros(scene.range_mm.shape, bool)
    count = scene.present.sum(-1)
    seen = int((count > 0).sum())
    if seen < LEAST_PIXELS or (count > 1).sum() + (scene.weight[..., 0] < 0.5).sum() < seen / 2:  # noqa: PLR2004  one half
        return marked
    first, error = scene.range_mm[..., 0], scene.stderr_mm[..., 0]
    ordered = np.sort(first[count > 0])
    # The range with the most neighbours: the middle of the shortest part that holds `LEAST_SHARE` of the pixels.
    held = math.ceil(LEAST_SHARE * seen)
    width = ordered[held - 1 :] - ordered[: seen - held + 1]
    start = int(width.argmin())
    common = float(np.median(ordered[start : start + held]))
    most_mm = 300.0  # farthest near return, mm: cover glass and housing are parts of the device
    if common > most_mm:
        return marked
    with np.errstate(invalid="ignore"):
        near = np.abs(first - common) <= np.maximum(NOISE_SIGMAS * error, scene.sigma_mm[..., 0])
        behind = (count > 1) | (scene.weight[..., 0] < 0.5)  # noqa: PLR2004  most of the samples are of other things
    members = near & behind
    if members.sum() >= LEAST_SHARE * seen:
        marked[..., 0] = members
    return marked


NEAR_RETURN = Suspicion(
    name="near_return",
    flag=8,
    short="near return",
    meaning="a near layer at one range in nearly every pixel, before other things: cover glass or housing",
    mark=mark_near_return,
)
