"""What can be known of a case at all: the sets of kinds that explain it as well as the truth, without noise.

What the truth adds to the given model is, for each pixel that sees one surface, a bias in each tenth of the time and a
change of the noise's width. A set of kinds is fitted to these by its laws, linear in small numbers; the model's own
errors (each surface's place and tilts to 0.1 sigma, the noise to 1 %) are fitted too, at a price. The rest is the
expected loss against the truth, in nats. This module uses the simulator's predictions and nothing of reconcile.

Kinds that act in another way (random values, returns of a cover glass, a memory, bursts and beats, a lattice, each
pixel's own bias, leaking neighbours) stand for themselves: none of the others does what they do. Leaking neighbours
must do something at all.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.distribution import Prediction
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.base import Level
from tofmix.simulation.exposure import predict
from tofmix.simulation.model import Model
from tofmix.simulation.surface import angle_changes
from users.cases import FRAMES, RATE_HZ, Case

KNOWN_NATS = 20.0
"""Loss of the best wrong set, from which a case is identifiable."""

TRACE_NATS = 10.0
"""Gain of a member of the truth, below which it leaves no trace."""

TENTHS = 10
_ALONE = 0.95  # share of the beam
_TOLERANCE, _NOISE = 0.1, 0.01  # errors of the model: of poses, sigma; of the noise
_SMALL = 0.01
_PEAKS = (0.2, 0.5, 1.0, 2.0, 4.0)  # noise in the middle of a spot, over the typical one
_PART_NATS = 7.8  # price of an optional part of a law: one effect more
_MAKE: Mapping[str, Callable[..., Effect]] = EFFECTS
_BY_THEMSELVES = (
    "outliers",
    "near_return",
    "temporal_correlation",
    "interference",
    "quantisation",
    "fixed_pattern",
    "pixel_crosstalk",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What the oracle says of a case."""

    traces: tuple[str, ...]
    """Kinds of the truth that leave a trace, sorted."""
    identifiable: bool
    """Whether every other set of as many kinds or fewer loses more than `KNOWN_NATS`."""
    aliases: tuple[tuple[str, ...], ...]
    """Sets of kinds that do not, the best first."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Of pixels that see one surface: biases (tenth, pixel), mm, and log widths (pixel,), with their information.

    And the standard deviation of each pixel's own bias, which hides what is static.
    """

    use: np.ndarray
    surface: np.ndarray
    sigma: FloatArray
    bias: FloatArray
    information: FloatArray
    width: FloatArray
    width_information: FloatArray
    pattern_mm: float = 0.0


def known(case: Case) -> Known:
    """Say what can be known of a case with effects, or with a moved surface."""
    static = tuple(e for e in case.hidden if not _by_itself(e))
    own = [e.kind for e in case.hidden if _by_itself(e) and _shows(case.given, e)]
    truth = sorted({e.kind for e in static})
    laws = _Laws(case.given, spots=_spots(static))
    true = case.true if case.sort == "pose" else replace(case.given, effects=static)
    own_bias = next((float(e.pixel_sigma_mm) for e in case.hidden if e.kind == "fixed_pattern"), 0.0)  # type: ignore[attr-defined]
    seen = replace(laws.seen(true, slower=_memory(case.hidden)), pattern_mm=own_bias)
    loss_of = laws.losses(seen)
    traces = _needed(truth, loss_of)
    aliases: list[tuple[float, tuple[str, ...]]] = []
    if traces:
        for size in range(1, len(traces) + 1):
            for kinds in combinations(laws.kinds, size):
                smaller = any(set(s) < set(kinds) for _, s in aliases)
                if set(kinds) >= set(traces) or smaller:
                    continue
                loss = loss_of(kinds)
                if loss <= KNOWN_NATS:
                    aliases.append((loss, kinds))
    aliases.sort()
    return Known(
        traces=tuple(sorted([*traces, *own])),
        identifiable=not aliases,
        aliases=tuple(tuple(sorted([*kinds, *own])) for _, kinds in aliases),
    )


def _spots(effects: Sequence[Effect]) -> tuple[dict[str, float], ...]:
    """Parts of the image in which effects act: other kinds may act there too."""
    numbers = ({n: v for n, v in e.numbers().items() if n.startswith("spot_")} for e in effects)
    return tuple(spot for spot in numbers if spot)


def _by_itself(effect: Effect) -> bool:
    """Whether no other kind does what an effect does; a second camera that is always on adds noise as others may."""
    return effect.kind in _BY_THEMSELVES and (effect.kind != "interference" or effect.hides)


def _needed(truth: Sequence[str], loss: Callable[[Sequence[str]], float]) -> list[str]:
    """The members of the truth without those that leave no trace beside the rest, the faintest left out first."""
    kept = list(truth)
    while kept:
        gains = {k: loss([t for t in kept if t != k]) - loss(kept) for k in kept}
        faintest = min(gains, key=lambda k: gains[k])
        if gains[faintest] > TRACE_NATS:
            break
        kept.remove(faintest)
    return kept


def _memory(hidden: Sequence[Effect]) -> float:
    """By how much a memory makes samples fewer."""
    rho = next((float(e.coefficient) for e in hidden if e.kind == "temporal_correlation"), 0.0)  # type: ignore[attr-defined]
    return (1 + rho) / (1 - rho)


def _shows(model: Model, effect: Effect) -> bool:
    """Whether an effect that stands for itself does anything: leaking needs neighbours that see something else."""
    if effect.kind != "pixel_crosstalk":
        return True
    before, after = predict(model), predict(replace(model, effects=(effect,)))
    moved = np.abs(_mean(after) - _mean(before)) / np.sqrt(_spread(before))
    wider = np.abs(_spread(after) / _spread(before) - 1)
    return float((FRAMES / 2 * (moved**2 + wider**2 / 2)).sum()) > TRACE_NATS


def _mean(p: Prediction) -> FloatArray:
    return np.asarray((p.weight * p.range_mm).sum(axis=0) / p.weight.sum(axis=0))


def _spread(p: Prediction) -> FloatArray:
    square = (p.weight * (p.range_mm**2 + p.sigma_mm**2)).sum(axis=0) / p.weight.sum(axis=0)
    return np.asarray(np.maximum(square - _mean(p) ** 2, 1e-6))


_Column = tuple[FloatArray, FloatArray]
"""What one number does to the biases (tenth, pixel) and the log widths (pixel,)."""


class _Laws:
    """The kinds' laws about a given model, as columns."""

    def __init__(self, given: Model, *, optional: bool = True, spots: Sequence[Mapping[str, float]] = ()) -> None:
        """With or without the optional parts of laws; of parts of the image, these."""
        self.given, self.spots = given, spots
        self.truth = cast_scene(given)
        self.at_rest = predict(given, self.truth)
        self.now = (np.arange(TENTHS) + 0.5) * FRAMES / TENTHS / RATE_HZ
        self.laws: dict[str, list[tuple[list[_Column], float]]] = {}
        for kind, columns in _COLUMNS.items():
            if kind not in ("multipath", "surface_offset") or len(given.surfaces) > 1:
                self.laws[kind] = [(law, 0.0) for law in columns(self)]
        for kind, parts in _OPTIONAL.items() if optional else ():
            further = [(law, _PART_NATS) for law in parts(self)]
            if further:
                self.laws[kind] = self.laws.get(kind, []) + further
        self.kinds = tuple(self.laws)

    def change(self, model: Model, time_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """What another model does to mean and log width (pixel,) of each pixel's main surface."""
        moves = any(e.level is Level.GEOMETRY for e in (*model.acting(), *self.given.acting()))
        same = not moves and model.surfaces == self.given.surfaces
        return _difference(self.at_rest, predict(model, self.truth if same else None, time_s=time_s))

    def of(self, size: float, kind: str, **values: Any) -> _Column:  # noqa: ANN401  parameters
        """A column: an effect over its size, the same at all times."""
        mean, width = self.change(replace(self.given, effects=(_MAKE[kind](**values),)))
        return np.tile(mean / size, (TENTHS, 1)), width / size

    def seen(self, true: Model, *, slower: float) -> _Seen:
        """What the truth does."""
        main = self.at_rest.weight.argmax(axis=0)[None]
        use = np.take_along_axis(self.at_rest.weight, main, axis=0)[0] > _ALONE * self.at_rest.weight.sum(axis=0)
        surface = np.take_along_axis(self.at_rest.surface, main, axis=0)[0]
        after = predict(true)
        use &= (surface >= 0) & (after.weight.max(axis=0) > _ALONE * after.weight.sum(axis=0))
        use &= np.take_along_axis(after.surface, after.weight.argmax(axis=0)[None], axis=0)[0] == surface
        each = [self.change(true, float(t)) for t in self.now]
        sigma = np.take_along_axis(self.at_rest.sigma_mm, main, axis=0)[0]
        true_sigma = sigma * np.exp(each[0][1])
        n = FRAMES / TENTHS / slower
        return _Seen(
            use=use,
            surface=surface,
            sigma=sigma,
            bias=np.stack([b for b, _ in each]),
            information=np.tile(n / true_sigma**2, (TENTHS, 1)),
            width=each[0][1],
            width_information=np.full(sigma.size, 2.0 * FRAMES / slower),
        )

    def losses(self, seen: _Seen) -> Callable[[Sequence[str]], float]:
        """Nats that the best set of laws of some kinds is behind the truth, as a function of the kinds."""
        columns: list[_Column] = []
        places: dict[str, list[tuple[list[int], float]]] = {}
        for kind, laws in self.laws.items():
            places[kind] = []
            for law, price in laws:
                places[kind].append((list(range(len(columns), len(columns) + len(law))), price))
                columns += law
        squares = _Squares(seen, columns, self.given)

        def loss(kinds: Sequence[str]) -> float:
            return min(
                squares.left([i for law, _ in chosen for i in law]) + sum(price for _, price in chosen)
                for chosen in product(*(places[k] for k in kinds))
            )

        return loss


def _difference(before: Prediction, after: Prediction) -> tuple[FloatArray, FloatArray]:
    first, then = before.weight.argmax(axis=0)[None], after.weight.argmax(axis=0)[None]
    mean = np.take_along_axis(after.range_mm, then, axis=0)[0] - np.take_along_axis(before.range_mm, first, axis=0)[0]
    ratio = np.take_along_axis(after.sigma_mm, then, axis=0)[0] / np.take_along_axis(before.sigma_mm, first, axis=0)[0]
    return mean, np.log(ratio)


class _Squares:
    """Weighted squares that sets of columns leave: the products of all columns are made once, a set takes its own."""

    def __init__(self, seen: _Seen, columns: Sequence[_Column], given: Model) -> None:
        use = seen.use
        errors, prices = _own_errors(seen, given)
        information = seen.information[:, use]
        whole = information.sum(axis=0)
        root, wide = np.sqrt(information), np.sqrt(seen.width_information[use])
        of_mean = np.sqrt(whole / (1 + whole * seen.pattern_mm**2))  # each pixel's own bias is integrated out

        def weighed(bias: FloatArray, width: FloatArray) -> FloatArray:
            mean = bias[:, use].mean(axis=0)
            return np.concatenate([((bias[:, use] - mean) * root).ravel(), mean * of_mean, width[use] * wide])

        design = np.stack([weighed(b, w) for b, w in (*columns, *errors)], axis=1)
        wanted = weighed(seen.bias, seen.width)
        self._gram = design.T @ design + np.diag([0.0] * len(columns) + [price**2 for price in prices])
        self._pull = design.T @ wanted
        self._whole = float(wanted @ wanted)
        self._errors = range(len(columns), design.shape[1])

    def left(self, columns: Sequence[int]) -> float:
        """Half of the weighted squares that these columns leave, the model's own errors fitted too."""
        taken = [*columns, *self._errors]
        gram, pull = self._gram[np.ix_(taken, taken)], self._pull[taken]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-30))
        found = np.linalg.lstsq(gram / scale[:, None] / scale, pull / scale, rcond=1e-12)[0] / scale
        return 0.5 * float(self._whole - 2 * pull @ found + found @ gram @ found)


def _own_errors(seen: _Seen, given: Model) -> tuple[list[_Column], list[float]]:
    """The model's own errors, as columns: the noise, and place and tilts of each surface. And the price of each."""
    use = seen.use
    nothing = np.zeros((TENTHS, use.size))
    rows, cols = given.sensor.shape
    row, col = np.divmod(np.arange(use.size), cols)
    columns: list[_Column] = [(nothing, np.ones(use.size))]
    prices = [1.0 / _NOISE]
    for number in range(len(given.surfaces)):
        own = use & (seen.surface == number)
        if own.any():
            error = _TOLERANCE * float(np.median(seen.sigma[own]))
            laws = (np.ones(use.size), 2 * col / cols - 1, 2 * row / rows - 1)
            columns += [(np.tile(np.where(own, law, 0.0), (TENTHS, 1)), np.zeros(use.size)) for law in laws]
            prices += [1.0 / error] * len(laws)
    return columns, prices


def _per_surface(laws: _Laws, make: Callable[[str], list[_Column]]) -> Iterator[list[_Column]]:
    for surface in laws.given.surfaces:
        yield make(surface.name)


def _pose(laws: _Laws) -> Iterator[list[_Column]]:
    def of(name: str) -> list[_Column]:
        surface = next(s for s in laws.given.surfaces if s.name == name)
        angles = [angle_changes(surface, tilts) for tilts in ((0.0, _SMALL), (_SMALL, 0.0))]
        turns = [
            laws.of(_SMALL, "surface_pose", surface=name, shift_mm=0.0, yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
            for yaw, pitch, roll in angles
        ]
        return [laws.of(1.0, "surface_pose", surface=name, shift_mm=1.0), *turns]

    return _per_surface(laws, of)


def _material(laws: _Laws) -> Iterator[list[_Column]]:
    return _per_surface(laws, lambda name: [laws.of(1.0, "surface_offset", surface=name, offset_mm=1.0)])


def _smooth(laws: _Laws) -> Iterator[list[_Column]]:
    for names in (("radial_2_mm", "radial_4_mm"), ("across_mm", "down_mm", "across_2_mm", "down_2_mm")):
        yield [laws.of(1.0, "smooth_pattern", **{name: 1.0}) for name in names]


def _motion(laws: _Laws) -> Iterator[list[_Column]]:
    def of(name: str) -> list[_Column]:
        mean, width = laws.of(1.0, "surface_pose", surface=name, shift_mm=1.0)
        return [(mean * laws.now[:, None], width)]

    return _per_surface(laws, of)


def _multipath(laws: _Laws) -> Iterator[list[_Column]]:
    turn = laws.given.sensor.turn_mm("the oracle")

    def of(name: str) -> list[_Column]:
        return [laws.of(_SMALL, "multipath", surface=name, share=_SMALL, extra_path_mm=p * turn) for p in (2.0, 0.5)]

    return _per_surface(laws, of)


def _wiggling(laws: _Laws) -> Iterator[list[_Column]]:
    yield [laws.of(1.0, "wiggling", amplitude_mm=1.0, phase_rad=p) for p in (0.0, math.pi / 2)]


def _further(laws: _Laws) -> Iterator[list[_Column]]:
    """With a sine of eight periods."""
    (own,) = _wiggling(laws)
    eight = (((8.0, 1.0, p),) for p in (0.0, math.pi / 2))
    yield [*own, *(laws.of(1.0, "wiggling", amplitude_mm=0.0, harmonics=sine) for sine in eight)]


def _taps(laws: _Laws, number: int) -> list[_Column]:
    """Both components of one sine."""
    return [
        laws.of(1.0, "tap_mismatch", **{f"amplitude_{number}_mm": 1.0, f"phase_{number}_rad": p})
        for p in (0.0, math.pi / 2)
    ]


def _saturating(laws: _Laws) -> Iterator[list[_Column]]:
    for saturation in (20.0, 60.0, 200.0, 600.0):
        numbers = {"scale_mm": 1.0, "reference_amplitude": 100.0, "saturation_amplitude": saturation}
        yield [laws.of(1.0, "amplitude_walk", exponent=exponent, **numbers) for exponent in (1.0, 2.0)]


def _two_terms(laws: _Laws) -> Iterator[list[_Column]]:
    mean, width = laws.of(1.0, "range_offset", offset_mm=1.0)
    for fast_s in (0.1, 0.2, 0.4):
        for slow_s in (0.8, 1.6, 3.0, 6.0):
            yield [(mean * -np.expm1(-laws.now[:, None] / tau_s), width) for tau_s in (slow_s, fast_s)]


def _walk(laws: _Laws) -> Iterator[list[_Column]]:
    for exponent in (0.3, 0.6, 1.0, 1.6, 2.5):
        yield [laws.of(1.0, "amplitude_walk", scale_mm=1.0, reference_amplitude=100.0, exponent=exponent)]


def _drift(laws: _Laws) -> Iterator[list[_Column]]:
    mean, width = laws.of(1.0, "range_offset", offset_mm=1.0)
    for tau_s in (0.3, 0.6, 1.0, 1.6, 2.5, 5.0):
        yield [(mean * -np.expm1(-laws.now[:, None] / tau_s), width)]


def _reflection(laws: _Laws) -> Iterator[list[_Column]]:
    """The phasor of a glass or a housing, a thousandth of a typical amplitude large, at each of some ranges."""
    small = 0.001 * float(np.median(laws.at_rest.amplitude[laws.at_rest.amplitude > 0]))
    for range_mm in (0.0, 75.0, 150.0):  # those of `cases`
        yield [laws.of(small, "internal_reflection", amplitude=small, range_mm=range_mm)]


def _noise(laws: _Laws) -> Iterator[list[_Column]]:
    """Of all surfaces, and of each."""
    yield [laws.of(_SMALL, "excess_noise", factor=math.exp(_SMALL))]
    if len(laws.given.surfaces) > 1:
        yield from _per_surface(
            laws, lambda name: [laws.of(_SMALL, "excess_noise", factor=math.exp(_SMALL), surface=name)]
        )


def _by_angle(laws: _Laws) -> Iterator[list[_Column]]:
    """Of all surfaces, with an exponent of the cosine of incidence."""
    plain = laws.of(_SMALL, "excess_noise", factor=math.exp(_SMALL))
    yield [plain, laws.of(_SMALL, "excess_noise", factor=1.0, angle_exponent=_SMALL)]
    for spot in laws.spots:  # the light of the same place, of which the noise of a second camera is the square
        for times in _PEAKS:
            yield [laws.of(1.0, "excess_noise", factor=math.hypot(1.0, times), **_narrower(spot))]


def _always(laws: _Laws) -> Iterator[list[_Column]]:
    """The noise of a second camera that is always on, at some sizes: it is added, so that small sigmas grow most."""
    typical = float(np.median(laws.at_rest.sigma_mm[0]))
    for part in (0.1, 0.5, 1.5, 4.0):
        yield [laws.of(1.0, "interference", probability=1.0, sigma_mm=part * typical)]
    for spot in laws.spots:
        for part in _PEAKS:
            yield [laws.of(1.0, "interference", probability=1.0, sigma_mm=part * typical, **spot)]


def _narrower(spot: Mapping[str, float]) -> dict[str, float]:
    """The spot whose light is the square of another one's."""
    return {name: value / math.sqrt(2) if "radius" in name else value for name, value in spot.items()}


def _bounce(laws: _Laws) -> Iterator[list[_Column]]:
    """Light of one bounce, to each surface from each other one that it faces."""
    for here, there in permutations((s.name for s in laws.given.surfaces), 2):
        column = laws.of(_SMALL, "multipath", surface=here, share=_SMALL, from_=there)
        if np.any(column[0]):
            yield [column]


_COLUMNS: dict[str, Callable[[_Laws], Iterator[list[_Column]]]] = {
    "range_offset": lambda laws: iter([[laws.of(1.0, "range_offset", offset_mm=1.0)]]),
    "surface_pose": _pose,
    "surface_offset": _material,
    "smooth_pattern": _smooth,
    "motion": _motion,
    "multipath": _multipath,
    "wiggling": _wiggling,
    "tap_mismatch": lambda laws: iter([_taps(laws, 1), _taps(laws, 2)]),
    "amplitude_walk": _walk,
    "temperature_drift": _drift,
    "scattering": lambda laws: iter([[laws.of(_SMALL, "scattering", share=_SMALL)]]),
    "internal_reflection": _reflection,
    "excess_noise": _noise,
    "vignetting": lambda laws: iter([[laws.of(_SMALL, "vignetting", corner_factor=math.exp(_SMALL))]]),
}
_OPTIONAL: dict[str, Callable[[_Laws], Iterator[list[_Column]]]] = {
    "wiggling": _further,
    "tap_mismatch": lambda laws: iter([_taps(laws, 1) + _taps(laws, 2)]),
    "amplitude_walk": _saturating,
    "temperature_drift": _two_terms,
    "excess_noise": _by_angle,
    "interference": _always,
    "multipath": _bounce,
}
"""Laws with parts that not every camera has."""
