"""What the summary says beside names and numbers."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, reconciled

from tofmix.reconciliation.words import closed_text, effect_tables, effect_text, headline, summary_lines, where_text
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.model import Model


def test_summary_has_the_size_of_a_map_and_the_number_of_stuck_pixels(small: Model) -> None:
    image = small.sensor.rows, small.sensor.cols
    biases = np.random.default_rng(7).normal(0, 12, image).astype(np.float32)
    stuck = np.full(image, np.nan, dtype=np.float32)
    stuck.flat[::32] = 3000
    hidden = (
        MAKE["fixed_pattern"](map=PixelMap("biases.npy", biases)),
        MAKE["stuck_pixels"](map=PixelMap("stuck.npy", stuck)),
    )
    result = reconciled(small, *hidden, kinds=("fixed_pattern", "stuck_pixels"))
    said = "\n".join(summary_lines(result))
    assert 'stuck_pixels ("stuck_pixels.npy", 8 pixels)' in said
    (size,) = set(re.findall(r'fixed_pattern \("fixed_pattern.npy", ([\d.]+) mm rms\)', said))
    working = biases[np.isnan(stuck)]
    assert abs(float(size) - np.sqrt((working**2).mean())) < 1.5


def test_headline_without_a_place_says_that_no_statistic_stands_out(small: Model) -> None:
    agreed = reconciled(small, kinds=("range_offset",))
    assert headline(agreed).startswith("Simulation and measurement agree")
    unexplained = replace(agreed, verified=replace(agreed.verified, verdict="unexplained"))
    assert headline(unexplained).startswith("No statistic stands out")
    named = reconciled(small, MAKE["range_offset"](offset_mm=9.0), kinds=("range_offset",))
    said = headline(replace(named, where=()))
    assert "disagree most where no single statistic shows it. range_offset" in said


def test_zero_is_written_without_a_sign(small: Model) -> None:
    result = reconciled(small, MAKE["range_offset"](offset_mm=9.0), kinds=("range_offset",))
    (named,) = result.named
    nothing = replace(
        named, effect=MAKE["range_offset"](offset_mm=-0.0), stderr={"offset_mm": 0.2}, heldout_gain_nats=-0.2
    )
    said = replace(result, named=(nothing,))
    assert effect_text(nothing, said) == "range_offset (offset_mm 0.00 +- 0.20)"
    assert "held-out gain 0 nats" in "\n".join(summary_lines(said))
    assert "-0" not in json.dumps(said.as_dict()["effects"]).replace("-0.2", "")
    assert "offset_mm = 0.0" in effect_tables(said)


@pytest.mark.parametrize(("amplitude_mm", "said"), [(12.0, "ranges grow by "), (-12.0, "ranges shrink by ")])
def test_a_warm_up_is_said_with_the_change_of_the_measured_ranges(small: Model, amplitude_mm: float, said: str) -> None:
    """Between means of the first and of the last tenth of 3.2 s, which hold 0.08 and 0.78 of the change."""
    drift = MAKE["temperature_drift"](amplitude_mm=amplitude_mm, time_constant_s=2.0)
    result = reconciled(small, drift, kinds=("temperature_drift",))
    place = next(p for p in result.where if p.statistic == "trend")
    assert np.sign(place.size) == np.sign(amplitude_mm)
    assert 0.5 * abs(amplitude_mm) < abs(place.size) < abs(amplitude_mm)
    assert f"({said}{abs(place.size):.3g} mm)" in where_text(place, result)


@pytest.mark.parametrize(
    ("closed", "said"), [(1.0031, "100 %"), (1.002499, "100 %"), (0.984, "98 %"), (-0.0004, "0 %")]
)
def test_closed_share_is_said_to_a_percent_and_never_above_the_whole_gap(closed: float, said: str) -> None:
    assert closed_text(closed) == said
