"""The summary of a layers file as numbers and tables."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from support.alike import MakeLayers, MakeSource

from tofmix.flags import Mixing, Status, status_name
from tofmix.grid import plan_windows
from tofmix.io.layers.layers_file import LayersWriter, open_layers
from tofmix.layers import Layers
from tofmix.report.summary.quantiles import ValueCounts
from tofmix.report.summary.summary import Summary, summarise
from tofmix.report.summary.tables import format_table
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor


def check_against_numpy(summary: Summary, windows: tuple[Layers, ...]) -> None:
    """Compare with counts and quantiles of everything held at once."""
    n_modes = np.stack([w.n_modes for w in windows])
    status = np.stack([w.status for w in windows])
    assert summary.pixels == n_modes.size
    assert list(summary.pixels_by_surfaces) == [int((n_modes == n).sum()) for n in range(windows[0].max_layers + 1)]
    assert summary.pixels_by_status == {status_name(s): int((status == s).sum()) for s in Status}
    assert summary.share_several_surfaces == pytest.approx((n_modes > 1).mean())
    assert summary.share_no_surface == pytest.approx((n_modes == 0).mean())
    for k, layer in enumerate(summary.layers):
        range_mm = np.concatenate([w.range[..., k].ravel() for w in windows]).astype(np.float64)
        known = np.isfinite(range_mm)
        assert layer.layer == k + 1
        assert layer.count == known.sum() == layer.range_mm.count
        expected = np.quantile(range_mm[known], [0.05, 0.5, 0.95])
        assert (layer.range_mm.q05, layer.range_mm.q50, layer.range_mm.q95) == pytest.approx(tuple(expected))
        for name, value in (
            ("weight", layer.weight_median),
            ("range_stderr", layer.range_stderr_median_mm),
            ("sigma", layer.sigma_median_mm),
        ):
            all_values = np.concatenate([getattr(w, name)[..., k].ravel() for w in windows])
            assert value == pytest.approx(np.nanmedian(all_values.astype(np.float64)))


def test_counts_and_quantiles_are_those_of_numpy(make_layers: MakeLayers, make_source: MakeSource) -> None:
    windows = tuple(make_layers((12, 7), seed=k) for k in range(3))
    source = make_source(*windows)
    check_against_numpy(summarise(source), windows)
    assert source.reads == [0, 1, 2]  # type: ignore[attr-defined]


def test_undecided_pixels_are_counted_apart(make_layers: MakeLayers, make_source: MakeSource) -> None:
    layers = make_layers((12, 7))
    mixing = np.zeros((12, 7), np.uint8)
    mixing[:3] = int(Mixing.UNDECIDED)
    summary = summarise(make_source(replace(layers, mixing=mixing)))
    expected = [int((layers.n_modes[3:] == n).sum()) for n in range(layers.max_layers + 1)]
    assert list(summary.decided_by_surfaces) == expected
    assert sum(summary.undecided_by_surfaces) == 3 * 7
    assert len(summary.undecided_by_surfaces) == layers.max_layers + 1
    assert sum(summary.pixels_by_surfaces) == 12 * 7
    assert "undecided               21   25.0 %  not counted above" in format_table(summary)


def test_a_real_file_gives_the_same(tmp_path: Path, make_layers: MakeLayers, make_source: MakeSource) -> None:
    windows = tuple(make_layers((4, 5), seed=k) for k in range(2))
    source = make_source(*windows)
    path = tmp_path / "a.layers.h5"
    with LayersWriter(
        path,
        windows=plan_windows(103, window=50),
        image=(4, 5),
        max_layers=4,
        tile=(1, 4),
        provenance=source.provenance,
    ) as writer:
        for k, layers in enumerate(windows):
            writer.write(slice(k, k + 1), slice(0, 4), layers.reshaped((1, 4, 5)))
    with open_layers(path) as file:
        assert summarise(file) == summarise(source)


def test_sigma_is_compared_where_a_layer_dominates(make_layers: MakeLayers, make_source: MakeSource) -> None:
    layers = make_layers((20, 20), seed=5)
    source = make_source(layers)
    summary = summarise(source)
    curve = source.provenance.sensor.noise
    assert curve is not None
    ratio = (layers.sigma / curve.sigma(layers.range.astype(np.float64)))[layers.weight > 0.5]
    assert summary.sigma_over_curve.count == ratio.size
    assert summary.sigma_over_curve.q50 == pytest.approx(np.median(ratio), rel=1e-6)
    assert "sigma_off_curve" in [w.code for w in summary.warnings]


def test_sigma_under_a_law_of_amplitude_is_not_compared_with_the_reference(
    make_layers: MakeLayers, make_source: MakeSource
) -> None:
    source = make_source(make_layers((20, 20), seed=5))
    curve = source.provenance.sensor.noise
    assert curve is not None
    law = AmplitudeLaw(np.full(curve.range_mm.shape, 100.0), np.array([10.0, 1000.0]), np.array([2.0, 0.5]))
    sensor = replace(source.provenance.sensor, noise=replace(curve, law=law))
    summary = summarise(replace(source, provenance=replace(source.provenance, sensor=sensor)))  # type: ignore[type-var]
    assert "sigma_off_curve" not in [w.code for w in summary.warnings]


def test_json_has_every_key_and_no_nan(make_layers: MakeLayers, make_source: MakeSource) -> None:
    source = make_source(make_layers(), options={"tol": float("nan"), "gamma": 0.02})
    values = summarise(source).as_dict()
    text = json.dumps(values, allow_nan=False)
    assert json.loads(text) == values
    assert list(values) == [f.name for f in fields(Summary)]
    assert values["options"] == {"gamma": 0.02, "tol": None}
    assert set(values["layers"][0]) == {
        "layer",
        "count",
        "range_mm",
        "weight_median",
        "range_stderr_median_mm",
        "sigma_median_mm",
        "sigma_over_curve_median",
    }


def test_no_surface_anywhere_gives_none_not_nan(make_source: MakeSource) -> None:
    layers = Layers.empty((2, 3), 2)
    layers.status[...] = Status.TOO_FEW_SAMPLES
    values = summarise(make_source(layers)).as_dict()
    json.dumps(values, allow_nan=False)
    assert values["layers"][0]["range_mm"] == {"count": 0, "q05": None, "q50": None, "q95": None}
    assert values["pixels_by_surfaces"] == [6, 0, 0]
    assert {w["code"] for w in values["warnings"]} == {
        "too_few_samples",
        "no_surface_anywhere",
        "flying_pixels_counted",
    }


def test_layers_on_both_sides_of_the_fold_are_close(make_source: MakeSource) -> None:
    layers = Layers.empty((1, 3), 3)
    layers.n_modes[0] = (2, 2, 1)
    layers.range[0, 0, :2], layers.range[0, 1, :2], layers.range[0, 2, 0] = (20.0, 6980.0), (1000.0, 6980.0), 20.0
    layers.sigma[0, :, :2] = 15.0
    line, circle = (
        summarise(make_source(layers, options=options)) for options in ({}, {"unambiguous_range_mm": 7000.0})
    )
    assert (line.pixels_with_close_layers, circle.pixels_with_close_layers) == (0, 1)


CURVE = NoiseCurve(np.array([500.0, 3000.0, 7500.0]), np.array([9.0, 70.0, 430.0]))


def test_sigma_is_compared_with_the_curve_on_the_circle(make_source: MakeSource) -> None:
    layers = Layers.empty((1, 1), 2)
    layers.n_modes[:], layers.weight[..., 0] = 1, 1.0
    layers.range[..., 0], layers.sigma[..., 0] = 3.0, CURVE.sigma(7000.0)
    summary = summarise(
        make_source(layers, options={"unambiguous_range_mm": 7000.0}, sensor=Sensor(name="x", noise=CURVE))
    )
    assert summary.sigma_over_curve.q50 == pytest.approx(1, abs=0.02)


def test_quantiles_are_numpys_and_memory_stays_bounded() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(0, 1000, 3001).astype(np.float32)
    counts = ValueCounts()
    for block in np.array_split(values, 7):
        counts.add(block)
    probabilities = [0.0, 0.05, 0.5, 0.777, 1.0]
    expected = np.quantile(values.astype(np.float64), probabilities)
    np.testing.assert_allclose(np.array(counts.quantiles(*probabilities), dtype=float), expected, rtol=1e-12)
    assert counts.count == values.size
    rng = np.random.default_rng(2)
    counts = ValueCounts(limit=4096)
    values = rng.uniform(650, 7500, 200_000).astype(np.float32)
    for block in np.array_split(values, 100):
        counts.add(block)
    assert counts.count == values.size
    assert counts._keys.size <= 4096
    quantiles = np.array(counts.quantiles(0.05, 0.5, 0.95), dtype=float)
    np.testing.assert_allclose(quantiles, np.quantile(values, [0.05, 0.5, 0.95]), rtol=1e-3)


def check_form(text: str) -> None:
    lines = text.splitlines()
    assert text.isascii()
    # Commands are whole, to be copied.
    assert max(len(line) for line in lines if not line.startswith("  try: tofmix ")) <= 80
    assert all(line == line.rstrip() for line in lines)
    assert "nan" not in text.lower()


@pytest.mark.parametrize("max_layers", [1, 2, 4, 32])
def test_table_is_short_and_narrow(max_layers: int, make_layers: MakeLayers, make_source: MakeSource) -> None:
    text = format_table(summarise(make_source(make_layers(max_layers=max_layers), source="ä" * 300 + "\x1b[31m")))
    check_form(text)
    assert len([line for line in text.splitlines() if not line.startswith("  try: ")]) <= 42


def test_table_holds_the_counts(make_layers: MakeLayers, make_source: MakeSource) -> None:
    layers = make_layers((40, 30), max_layers=2)
    lines = format_table(summarise(make_source(layers))).splitlines()
    rows = {line.split()[0]: line.split() for line in lines if line}
    for n in range(3):
        assert rows[f"{n}"][1] == str((layers.n_modes == n).sum())
    assert rows["first"][1] == str(np.isfinite(layers.range[..., 0]).sum())
    assert rows["no_surface"][1] == str((layers.status == Status.NO_SURFACE).sum())
    assert "3 frames left out" in "\n".join(lines)


def test_table_keeps_its_columns_of_a_million_pixels_and_of_none(make_source: MakeSource) -> None:
    layers = Layers.empty((1000, 1200), 1)
    layers.n_modes[...], layers.n_peaks[...], layers.n_samples[...] = 1, 1, 100
    layers.range[...], layers.sigma[...], layers.weight[...], layers.range_stderr[...] = 71234, 1234.5, 1, 123.4
    text = format_table(summarise(make_source(layers)))
    check_form(text)
    assert "  1200000" in text
    layers = Layers.empty((1, 1), 3)
    layers.status[...] = Status.TOO_FEW_SAMPLES
    text = format_table(summarise(make_source(layers)))
    check_form(text)
    assert "warning: No pixel shows a surface." in text
