"""Slow and obvious twins of the kernels of unmixing, in plain NumPy, one pixel at a time."""

from itertools import pairwise
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.unmixing.image import PhasorImage
from tofmix.unmixing.seeds import Seeds
from tofmix.unmixing.surface_fit import Members


def least_squares(
    x: FloatArray, y: FloatArray, values: FloatArray, weights: FloatArray, slope_weight: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients, covariance and residuals of v = a + b x + c y, with a Gaussian prior on b and c."""
    design = np.stack([np.ones_like(x), x, y], axis=1)
    information = design.T @ (design * weights[:, None]) + np.diag([0.0, slope_weight, slope_weight])
    covariance: FloatArray = np.asarray(np.linalg.inv(information), dtype=np.float64)
    coefficients: FloatArray = np.asarray(covariance @ (design.T @ (weights * values)), dtype=np.float64)
    return coefficients, covariance, values - design @ coefficients


def local(image: PhasorImage, pixel: int, other: int) -> tuple[float, float, float]:
    """Cosine between two beams, and where the other one goes through the plane across the first, in pixels."""
    way = image.directions[other]
    cosine = float(way @ image.directions[pixel])
    x = float(way @ image.across[pixel]) / cosine / image.pitch_across[pixel]
    return cosine, x, float(way @ image.down[pixel]) / cosine / image.pitch_down[pixel]


def surfaces_beside(image: PhasorImage, pixel: int, members: Members, seeds: Seeds) -> list[dict[str, Any]]:
    """The surfaces beside a pixel, the largest first: fields of `NeighbourSurfaces`."""
    places = []
    row, col = divmod(pixel, image.shape[1])
    for other in np.flatnonzero(members.is_member):
        down, right = int(other) // image.shape[1] - row, int(other) % image.shape[1] - col
        if other != pixel and max(abs(down), abs(right)) <= 4:
            places.append(_place(image, pixel, int(other), down, right, members, seeds))
    for line in {place["line"] for place in places} - {-1}:
        _predict_together(image, pixel, [place for place in places if place["line"] == line], seeds)
    places.sort(key=lambda place: place["value"])
    groups = [places[:1]] if places else []
    for before, place in pairwise(places):
        apart = 4.0 * np.sqrt(2.0 * min(place["error"], before["error"]))
        begins = place["value"] - before["value"] > max(apart, 0.01 * abs(before["value"]))
        begins |= _contradict(place, min(groups[-1], key=lambda one: one["error"]))
        groups = [*groups, [place]] if begins else [*groups[:-1], [*groups[-1], place]]
    groups = [part for group in groups for part in _parted_from_behind(group)]

    def close(group: list[dict[str, Any]]) -> int:
        return sum(max(abs(place["down"]), abs(place["right"])) <= 3 for place in group)

    large = [group for group in groups if close(group) > 0 and len(group) > 1]
    large.sort(key=lambda group: (-close(group), -len(group)))
    return [_surface(image, pixel, group, members, seeds) for group in large[:4]]


def _parted_from_behind(group: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Parts of a group such that none contradicts the most certain one of those behind it, of its part."""
    parts = [[group[-1]]]
    for place in reversed(group[:-1]):
        if _contradict(place, min(parts[0], key=lambda one: one["error"])):
            parts = [[place], *parts]
        else:
            parts[0] = [place, *parts[0]]
    return parts


def _contradict(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two predictions, one of a narrow surface, differ by more than their errors, in range or in light."""
    apart = max(4.0 * np.sqrt(one["error"] + other["error"]), 0.01 * abs(other["value"]))
    off = abs(one["light"] - other["light"]) > 4.0 * np.sqrt(one["light_error"] + other["light_error"])
    narrow = one["line"] >= 0 or other["line"] >= 0
    return bool(narrow and (abs(one["value"] - other["value"]) > apart or off))


def _predict_together(image: PhasorImage, pixel: int, line: list[dict[str, Any]], seeds: Seeds) -> None:
    """1 / r and u at the pixel of a narrow surface, for all of its members."""
    other = np.array([place["other"] for place in line])
    x, y, near, cosine, variance = (
        np.array([place[name] for place in line]) for name in ("x", "y", "near", "cosine", "variance")
    )
    noise = image.light_variance[other] + 9.0 * image.range_variance[other] * near**2 + seeds.texture_variance
    slope = 0.25 * image.pitch[pixel] * (near / cosine).mean()
    light_slope = 2.0 * image.pitch[pixel] + 0.005
    for name, values, spread, steepest in (
        ("value", near / cosine, variance, slope),
        ("light", image.log_light[other], noise, light_slope),
    ):
        level = values.mean()
        fit, covariance, residuals = least_squares(x, y, values - level, 1.0 / spread, steepest**-2)
        error = widened(covariance, residuals, 1.0 / spread, spread)[0, 0]
        for place in line:
            place[name] = level + fit[0]
            place["error" if name == "value" else "light_error"] = error


def _place(
    image: PhasorImage, pixel: int, other: int, down: int, right: int, members: Members, seeds: Seeds
) -> dict[str, Any]:
    """One member: where it is, and what it predicts at the pixel."""
    cosine, x, y = local(image, pixel, other)
    near = 1.0 / image.range_mm[other]
    variance = (image.range_variance[other] + seeds.pattern_variance) * near**4
    if members.has_plane[other]:
        value = float(members.plane[other] @ image.directions[pixel])
        middle = np.array(divmod(int(members.middle[other]), image.shape[1]))
        away = float(((middle - divmod(pixel, image.shape[1])) ** 2).sum())
        error = variance * (1.0 / 9.0 + away / 6.0)
    else:
        value = near / cosine
        error = variance + (down**2 + right**2) * (2.0 * image.pitch[pixel] * near) ** 2
    light_error = image.light_variance[other] + 9.0 * image.range_variance[other] * near**2 + seeds.texture_variance
    light_error += (down**2 + right**2) * (2.0 * image.pitch[pixel] + 0.005) ** 2
    line = int(members.line[other])
    lit = {"light": image.log_light[other], "light_error": light_error, "line": line}
    return lit | {
        "other": other,
        "down": down,
        "right": right,
        "cosine": cosine,
        "x": x,
        "y": y,
        "near": near,
        "variance": variance,
        "value": value,
        "error": error,
    }


def _surface(
    image: PhasorImage, pixel: int, group: list[dict[str, Any]], members: Members, seeds: Seeds
) -> dict[str, Any]:
    """Planes of 1 / r and of u through a surface's pixels, and what these are."""
    other = np.array([place["other"] for place in group])
    cosine, x, y, near, variance, down, right = (
        np.array([place[name] for place in group], float)
        for name in ("cosine", "x", "y", "near", "variance", "down", "right")
    )
    has_plane = members.has_plane[other]
    plane = members.plane[other][has_plane].mean(axis=0) if has_plane.any() else near.mean() * image.directions[pixel]
    values = (near - image.directions[other] @ plane) / cosine
    slope = (0.25 if has_plane.any() else 2.0) * image.pitch[pixel] * near.mean()
    weights = 1.0 / variance
    _, _, residuals = least_squares(x, y, values, weights, slope**-2)
    kept = residuals**2 * weights <= 16.0
    weights = np.where(kept, weights, 0.0) if 2 * kept.sum() >= len(group) else weights
    coefficients, covariance, residuals = least_squares(x, y, values, weights, slope**-2)
    own = np.array(
        [
            plane @ image.directions[pixel],
            plane @ image.across[pixel] * image.pitch_across[pixel],
            plane @ image.down[pixel] * image.pitch_down[pixel],
        ]
    )
    noise = image.light_variance[other] + 9.0 * image.range_variance[other] * near**2 + seeds.texture_variance
    lit = (weights > 0) & members.has_light[other]
    used = lit if lit.any() else weights > 0
    fade = np.where(used, np.exp(-(down**2 + right**2) / 8.0) / noise, 0.0)
    light_slope = 2.0 * image.pitch[pixel] + 0.005
    level = (image.log_light[other] * fade).sum() / fade.sum()
    light, light_covariance, light_residuals = least_squares(
        x, y, image.log_light[other] - level, fade, light_slope**-2
    )
    most = {
        name: 2 * getattr(members, name)[other].sum() >= len(group) for name in ("is_known", "is_trusted", "is_fresh")
    }
    means = {
        name: getattr(image, name)[other].mean()
        for name in ("noise_radial", "noise_tangential", "scatter_radial", "scatter_tangential")
    }
    return (
        most
        | means
        | {
            "near": coefficients + own,
            "near_covariance": widened(covariance, residuals, weights, variance),
            "light": light + np.array([level, 0.0, 0.0]),
            "light_covariance": widened(light_covariance, light_residuals, fade, noise),
            "row": down.mean(),
            "col": right.mean(),
        }
    )


def widened(covariance: FloatArray, residuals: FloatArray, weights: FloatArray, variance: FloatArray) -> FloatArray:
    """A fit's covariance, where its residuals scatter more than noise."""
    used = weights > 0
    square, chance = (residuals**2 * weights)[used].sum(), (weights * variance)[used]
    out = covariance * max(1.0, square / max(used.sum() - 3, 1))
    free = max(chance.sum() ** 2 / (chance**2).sum() - 3.0, 1.0)
    excess = square / chance.sum() - 1.0 - 2.0 * np.sqrt(2.0 / free)
    out[0, 0] += max(excess, 0.0) * (chance * variance[used]).sum() / chance.sum()
    return np.asarray(out)
