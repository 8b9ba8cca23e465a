"""Passing: a layer whose samples lie in a part of the frames only, such as a person's who walks by.

Its samples are closer in time than chance puts them, and that part is less than half of the frames. Where samples
remember those before them, frames count as fewer. A net in the wind is spread over the frames, and is no passing layer.

Where frames are of several kinds (`tofmix.suspicion.frame_kinds`), layers that only the frames of another than the main
kind show are in a part of the frames too, and those of the main kind are not.
"""

import math
from itertools import product

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.segments import around
from tofmix.suspicion.frame_kinds import NOISE_SIGMAS
from tofmix.suspicion.scene import CLUSTER_FIELDS, FALSE_MARKS, LONGEST, Suspicion, WindowScene

_ROW, _COL, _LAYER, _FRAMES, _SAMPLES, _OUTSIDE, _LENGTH, _FIRST, _LAST = range(len(CLUSTER_FIELDS))


def mark_passing(scene: WindowScene) -> BoolArray:
    """Layers (row, col, layer) that are in a part of the frames only.

    Of layers that are there all the time, `FALSE_MARKS` at most are marked.
    """
    marked = _close_in_time(scene)
    kind = scene.kind_of_layer
    return np.asarray((marked | (kind > 0)) & (kind != 0))


def _close_in_time(scene: WindowScene) -> BoolArray:
    """Layers (row, col, layer) whose samples are closer in time than chance puts them."""
    marked = np.zeros(scene.range_mm.shape, bool)
    found = scene.clusters
    if not len(found):
        return marked
    memory_frames = _memory_frames(scene.memory)
    chances = np.array(_log_chances(found, memory_frames))
    place = tuple(found[:, [_ROW, _COL, _LAYER]].astype(int).T)
    may_pass = ~_continues(scene, *place)
    sure = may_pass & (chances <= math.log(_mark_below(scene, np.exp(chances[may_pass]))))
    # Chance below which a layer beside a passing one, in its frames alone, is of it too: there the odds are even.
    beside_passing = 0.05
    while sure.any():  # each round reaches one pixel farther
        beside = _log_chances_beside(found, sure, scene.range_mm.shape[:2], memory_frames)
        more = may_pass & ~sure & (beside <= math.log(beside_passing))
        if not more.any():
            break
        sure |= more
    marked[tuple(part[sure] for part in place)] = True
    return marked


def _mark_below(scene: WindowScene, chances: FloatArray, *, level: float = 0.2, false_share: float = 0.1) -> float:
    """Chance below which a layer is marked: `FALSE_MARKS`, or more where many layers pass, as in snow.

    Layers that are there all the time have evenly spread chances; the number of those above `level` tells how many
    there are. More are marked as long as such layers are at most `false_share` of the marked, and `FALSE_MARKS` of all.

    References
    ----------
    Benjamini and Hochberg, JRSS B 57(1), 1995; Storey, JRSS B 64(3), 2002, doi:10.1111/1467-9868.00346.
    """
    rare = int(np.sum(scene.weight <= LONGEST))
    standing = max(rare - int(np.sum(chances <= level)), 1) / (1.0 - level)
    ordered = np.sort(chances[chances <= min(FALSE_MARKS * scene.present.sum() / standing, level)])
    many = ordered * standing <= false_share * np.arange(1, len(ordered) + 1)
    return max(FALSE_MARKS, float(ordered[many].max(initial=0.0)))


def _continues(scene: WindowScene, row: IntArray, col: IntArray, layer: IntArray) -> BoolArray:
    """Which layers (n,) belong to a surface that their pixel, or one beside it, sees for most of the time.

    At the edge of a standing surface a shift by a part of a pixel changes shares, so that its samples come in groups. A
    surface that drifts within the window may be several layers, each in a part of the frames: all together are there
    for most of the time.
    """
    pad = ((1, 1), (1, 1), (0, 0))
    together = _weight_of_chains(scene)
    stands = np.where(together > LONGEST, scene.range_mm, np.nan)
    around, sigma = (np.pad(values, pad, constant_values=np.nan) for values in (stands, scene.sigma_mm))
    own, width = scene.range_mm[row, col, layer], scene.sigma_mm[row, col, layer]
    out = together[row, col, layer] > LONGEST
    slope = 0.05  # how much ranges of one surface differ between neighbouring pixels, of the range
    for down, right in product(range(3), range(3)):
        if (down, right) != (1, 1):
            there = around[row + down, col + right]
            noise = NOISE_SIGMAS * np.hypot(sigma[row + down, col + right], width[:, np.newaxis])
            with np.errstate(invalid="ignore"):
                near = np.abs(there - own[:, np.newaxis]) <= slope * own[:, np.newaxis] + noise
            out |= near.any(-1)
    return out


def _weight_of_chains(scene: WindowScene) -> FloatArray:
    """Weight (row, col, layer) of each layer with those of its pixel that noise joins to it, from one to the next."""
    joined, out = scene.joined, np.nan_to_num(scene.weight)
    for layer in range(1, out.shape[-1]):  # near to far: each has the sum of its chain so far
        out[..., layer] += np.where(joined[..., layer - 1], out[..., layer - 1], 0.0)
    for layer in range(out.shape[-1] - 2, -1, -1):  # and back: that of the whole
        out[..., layer] = np.where(joined[..., layer], out[..., layer + 1], out[..., layer])
    return out


def _log_chances_beside(found: FloatArray, sure: BoolArray, shape: tuple[int, int], memory_frames: float) -> FloatArray:
    """Log chance (n,) that all frames of a cluster are those of the passing layers in its pixel and beside it.

    A frame before their first and after their last counts as theirs: the thing moves. 0 where there is no such layer.
    """
    first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
    rows, cols = found[sure, _ROW].astype(int), found[sure, _COL].astype(int)
    np.minimum.at(first, (rows, cols), found[sure, _FIRST] - 1.0)
    np.maximum.at(last, (rows, cols), found[sure, _LAST] + 1.0)
    row, col = found[:, _ROW].astype(int), found[:, _COL].astype(int)
    least, most = around(first, np.minimum)[row, col], around(last, np.maximum)[row, col]
    within = (least <= found[:, _FIRST]) & (most >= found[:, _LAST])
    share = np.where(within, (most - least + 1.0) / found[:, _FRAMES], 1.0)
    independent = 1.0 + (found[:, _SAMPLES] - 1.0) / memory_frames
    return np.asarray(independent * np.log(np.minimum(share, 1.0)))


def _memory_frames(memory: FloatArray) -> float:
    """How many frames tell as much as one without memory: (1 + q) / (1 - q) with the correlation q of neighbours.

    q is the larger of two: that of the noise of the pixels' main layers, and that of whether a frame shows a rare
    layer, within its interval. The latter is 0 where the samples in the interval follow each other by chance, and 1
    where they come in one group; an interval that they fill tells nothing. `memory` has `MEMORY_FIELDS`.
    """
    products, squares, pairs, most = memory
    correlation = max(products / squares if squares > 0 else 0.0, pairs / most if most > 0 else 0.0)
    most_correlation = 0.99  # from frame to frame: a recording with more has no independent frames to speak of
    correlation = min(max(correlation, 0.0), most_correlation)
    return float((1.0 + correlation) / (1.0 - correlation))


def _log_chances(found: FloatArray, memory_frames: float) -> list[float]:
    """Log chance (n,) of each cluster, with frames that remember those before them."""
    from tofmix.suspicion.evidence import log_chance  # compiled: readers of marks do not wait for it

    out = []
    for line in found:
        # A sample stands for its successors: of m samples in a row, 1 + (m - 1) / memory are independent.
        m = 1.0 + (line[_SAMPLES] - 1.0) / memory_frames
        outside = line[_OUTSIDE] / memory_frames
        length = max(line[_LENGTH] / memory_frames, m - outside)
        frames = max(line[_FRAMES] / memory_frames, length, m)
        out.append(log_chance(float(frames), float(m), float(outside), float(length)))
    return out


PASSING = Suspicion(
    name="passing",
    flag=4,
    short="in a part of the frames",
    meaning="its samples lie in a part of the frames only, as of a thing that passes",
    mark=mark_passing,
)
