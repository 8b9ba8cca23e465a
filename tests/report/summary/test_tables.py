from collections.abc import Callable

import numpy as np
import pytest

from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.report.sources import LayersSource
from tofmix.report.summary.summary import summarise
from tofmix.report.summary.tables import format_table, ordinal, printable


def check_form(text: str) -> None:
    lines = text.splitlines()
    assert text.isascii()
    # Commands are whole, to be copied.
    assert max(len(line) for line in lines if not line.startswith("  try: tofmix ")) <= 80
    assert all(line == line.rstrip() for line in lines)
    assert "nan" not in text.lower()


@pytest.mark.parametrize("max_layers", [1, 2, 4, 32])
def test_table_is_short_and_narrow(
    max_layers: int, make_layers: Callable[..., Layers], make_source: Callable[..., LayersSource]
) -> None:
    text = format_table(summarise(make_source(make_layers(max_layers=max_layers), source="ä" * 300 + "\x1b[31m")))
    check_form(text)
    assert len([line for line in text.splitlines() if not line.startswith("  try: ")]) <= 42


def test_table_holds_the_counts(make_layers: Callable[..., Layers], make_source: Callable[..., LayersSource]) -> None:
    layers = make_layers((40, 30), max_layers=2)
    lines = format_table(summarise(make_source(layers))).splitlines()
    rows = {line.split()[0]: line.split() for line in lines if line}
    for n in range(3):
        assert rows[f"{n}"][1] == str((layers.n_modes == n).sum())
    assert rows["first"][1] == str(np.isfinite(layers.range[..., 0]).sum())
    assert rows["no_surface"][1] == str((layers.status == Status.NO_SURFACE).sum())
    assert "3 frames left out" in "\n".join(lines)


def test_a_million_pixels_keep_the_columns_apart(make_source: Callable[..., LayersSource]) -> None:
    layers = Layers.empty((1000, 1200), 1)
    layers.n_modes[...], layers.n_peaks[...], layers.n_samples[...] = 1, 1, 100
    layers.range[...], layers.sigma[...], layers.weight[...], layers.range_stderr[...] = 71234, 1234.5, 1, 123.4
    text = format_table(summarise(make_source(layers)))
    check_form(text)
    assert "  1200000" in text


def test_table_without_fitted_pixels_shows_dashes(make_source: Callable[..., LayersSource]) -> None:
    layers = Layers.empty((1, 1), 3)
    layers.status[...] = Status.TOO_FEW_SAMPLES
    text = format_table(summarise(make_source(layers)))
    check_form(text)
    assert "warning: No pixel shows a surface." in text


def test_tied_sigma_is_noted(make_layers: Callable[..., Layers], make_source: Callable[..., LayersSource]) -> None:
    assert "tied" in format_table(summarise(make_source(make_layers(), options={"sigma": "tied"})))


def test_names_cannot_drive_the_terminal() -> None:
    assert printable("a\x1b[2Jb\nc") == r"a\x1b[2Jb\nc"
    assert printable("ü") == r"\xfc"
    assert len(printable("x" * 100, 20)) == 20


def test_ordinals_have_their_suffixes() -> None:
    assert [ordinal(k) for k in (1, 3, 7)] == ["first", "third", "layer 7"]
