"""Two layers files against each other, by a loop over pixels and layers."""

import math
from typing import Any

import numpy as np
import pytest
from support.made_up import LayersInMemory, made_up_layers

from tofmix.errors import BadInputError
from tofmix.flags import Status
from tofmix.layers import LAYER_FIELDS, Layers, Provenance
from tofmix.report.comparison import (
    Comparison,
    compare,
    compare_windows,
    format_comparison,
)
from tofmix.sensor import Sensor

SHAPE, MAX_LAYERS = (2, 8, 9), 3


class Source(LayersInMemory):
    """Layers with what a file says of them."""

    def __init__(self, layers: Layers, *, frames: int = 20, source: str = "a.h5", **options: Any) -> None:  # noqa: ANN401  any option
        super().__init__(layers)
        self.mixing_law = None
        self.window_start = np.arange(self.shape[0], dtype=np.uint64) * np.uint64(frames)
        self.window_stop = self.window_start + np.uint64(frames)
        self.provenance = Provenance(
            source=source, source_sha256=source, version="1", sensor=Sensor(name="camera"), options=options
        )


def copied(layers: Layers) -> Layers:
    return Layers(**{spec.name: getattr(layers, spec.name).copy() for spec in LAYER_FIELDS})


def disturbed(layers: Layers, seed: int = 5) -> Layers:
    """The same layers with some ranges moved, some counts changed and some status changed."""
    rng = np.random.default_rng(seed)
    out = copied(layers)
    moved = rng.random(out.range.shape) < 0.2
    out.range[moved] += (rng.normal(0, 4, out.range.shape) * np.nan_to_num(out.range_stderr, nan=1.0))[moved]
    fewer = (rng.random(SHAPE) < 0.1) & (out.n_modes > 0)
    for place in zip(*np.nonzero(fewer), strict=True):
        out.n_modes[place] -= 1
        for name in ("range", "sigma", "weight", "range_stderr", "weight_stderr", "probability"):
            getattr(out, name)[place][out.n_modes[place] :] = np.nan
    out.status[rng.random(SHAPE) < 0.1] = Status.NOT_CONVERGED
    return out


def by_loops(a: Layers, b: Layers, tolerance: float) -> dict[str, int]:
    found = dict.fromkeys(("count_differs", "range_differs", "status_differs", "layers_compared", "layers_differ"), 0)
    for place in np.ndindex(*a.shape):
        found["status_differs"] += int(a.status[place] != b.status[place])
        if a.n_modes[place] != b.n_modes[place]:
            found["count_differs"] += 1
            continue
        beyond = 0
        for k in range(a.n_modes[place]):
            squares = float(a.range_stderr[place][k]) ** 2 + float(b.range_stderr[place][k]) ** 2
            allowed = 0.0 if math.isnan(squares) else tolerance * math.sqrt(squares)
            beyond += abs(float(a.range[place][k]) - float(b.range[place][k])) > allowed
        found["layers_compared"] += int(a.n_modes[place])
        found["layers_differ"] += beyond
        found["range_differs"] += beyond > 0
    return found


@pytest.mark.parametrize("tolerance", [0.0, 1.0, 3.0, 100.0])
def test_counts_are_those_of_loops(tolerance: float) -> None:
    a = made_up_layers(SHAPE, MAX_LAYERS)
    b = disturbed(a)
    found = compare(Source(a), Source(b), tolerance=tolerance)
    expected = by_loops(a, b, tolerance)
    assert {name: getattr(found, name) for name in expected} == expected
    assert expected["count_differs"] > 0
    assert found.different == found.count_differs + found.range_differs == sum(found.different_by_window)
    assert sum(count for _, _, count in found.surfaces) == found.count_differs


def test_a_file_equals_itself_and_order_changes_nothing_but_sides() -> None:
    a = made_up_layers(SHAPE, MAX_LAYERS)
    b = disturbed(a)
    same = compare(Source(a), Source(a), tolerance=0.0)
    assert same.different == same.status_differs == 0
    assert same.gap_largest_mm == same.gap_largest_errors == 0.0
    assert same.equal(0.0)
    one, other = compare(Source(a), Source(b)), compare(Source(b), Source(a))
    assert (one.different, one.gap_largest_mm) == (other.different, other.gap_largest_mm)
    assert {(x, y, n) for x, y, n in one.surfaces} == {(y, x, n) for x, y, n in other.surfaces}
    assert one.equal(1.0)
    assert not one.equal(0.0)
    assert one.equal(one.different / one.pixels)


def test_files_of_another_max_layers_are_equal_and_of_other_sizes_refused() -> None:
    a = made_up_layers(SHAPE, MAX_LAYERS)
    wide = Layers.empty(SHAPE, MAX_LAYERS + 2)
    for spec in LAYER_FIELDS:
        target = getattr(wide, spec.name)
        (target[..., :MAX_LAYERS] if spec.per_layer else target)[...] = getattr(a, spec.name)
    for one, other in ((a, wide), (wide, a)):
        assert compare(Source(one), Source(other), tolerance=0.0).different == 0
    a = made_up_layers(SHAPE, MAX_LAYERS)
    with pytest.raises(BadInputError, match="2 windows of 8 x 9 pixels and 1 window of 8 x 9 pixels"):
        compare(Source(a), Source(made_up_layers((1, 8, 9), MAX_LAYERS)))
    with pytest.raises(BadInputError, match=r"windows have \[20\] and \[10\] frames"):
        compare(Source(a), Source(a, frames=10))


def test_pixels_are_compared_by_ranges_and_errors() -> None:
    a = made_up_layers((1, 2, 2), 1)
    a.n_modes[...], a.range[...], a.range_stderr[...] = 1, 1000.0, np.nan
    b = copied(a)
    assert not compare_windows(a, b, tolerance=3.0).differs.any()
    b.range[0, 0, 0] += 0.01
    found = compare(Source(a), Source(b))
    assert found.range_differs == 1
    assert found.gap_largest_errors is None
    assert found.pixels_shown[0].gap_errors is None
    a = made_up_layers(SHAPE, MAX_LAYERS)
    found = compare(Source(a), Source(disturbed(a)), tolerance=0.5)
    assert len(found.pixels_shown) == min(20, found.different)
    ranks = [
        (-abs(p.surfaces[0] - p.surfaces[1]), -(p.gap_errors or math.inf if p.surfaces[0] == p.surfaces[1] else 0.0))
        for p in found.pixels_shown
    ]
    assert ranks == sorted(ranks)
    top = found.pixels_shown[0]
    assert len(top.range_a_mm) == a.n_modes[top.window, top.row, top.col] == top.surfaces[0]


def _comparison() -> tuple[Source, Source, Comparison]:
    layers = made_up_layers(SHAPE, MAX_LAYERS)
    a, b = Source(layers, gamma=0.02), Source(disturbed(layers), source="<b>.h5", gamma=0.1, extra=math.nan)
    return a, b, compare(a, b)


def test_table_and_json_have_the_same_numbers() -> None:
    _, _, found = _comparison()
    text = format_comparison(found, names=("a.layers.h5", "b\x1b.layers.h5"), allow=0.0)
    assert text.isascii()
    assert "\x1b" not in text
    assert f"{found.different:>8}" in text
    assert "option gamma: 0.02 in A, 0.1 in B" in text
    assert text.endswith("\ndifferent")
    assert format_comparison(found, names=("a", "b"), allow=1.0).endswith("\nequal")
    assert found.as_dict()["options"] == {"gamma": (0.02, 0.1)}  # extra: NaN there, missing here


def test_on_a_circle_layers_are_paired_in_the_order_round_it_that_differs_least() -> None:
    length, rng = 7495.0, np.random.default_rng(8)
    a, b = (copied(made_up_layers(SHAPE, MAX_LAYERS, seed=3)) for _ in range(2))
    near_fold = rng.normal(0.0, 30.0, SHAPE)
    for place in np.ndindex(*SHAPE):
        n = int(a.n_modes[place])
        if n == 0:
            continue
        true = np.append(near_fold[place], np.sort(rng.uniform(600, 6500, n - 1)))
        for layers in (a, b):
            layers.range[place][:n] = np.sort((true + rng.normal(0.0, 20.0, n)) % length)
    source_a, source_b = (Source(layers, unambiguous_range_mm=length) for layers in (a, b))
    found = compare(source_a, source_b, tolerance=1e9)
    largest = 0.0
    for place in np.ndindex(*SHAPE):
        n = int(a.n_modes[place])
        turns = [np.roll(b.range[place][:n].astype(float), -k) - a.range[place][:n] for k in range(n)]
        short = [np.abs((gap + length / 2) % length - length / 2) for gap in turns]
        largest = max([largest, *(min(short, key=np.sum).tolist() if n else [])])
    assert found.gap_largest_mm == pytest.approx(largest, abs=1e-3)
    assert largest < 200
    assert (compare(Source(a), Source(b)).gap_largest_mm or 0) > 7000
    other = Source(b, unambiguous_range_mm=7000.0)
    assert (compare(source_a, other).gap_largest_mm or 0) > 7000  # not on one circle: as on a line
