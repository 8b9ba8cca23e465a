"""What the headline says beside names and numbers."""

import json
import re
from dataclasses import replace

import numpy as np
from recordings import MAKE, Record

from tofmix.reconciliation.way import Settings
from tofmix.reconciliation.words import effect_tables, effect_text, headline, summary_lines
from tofmix.reconciliation.workflow import reconcile
from tofmix.report.gap_page import render_gap
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.model import Model

IMAGE = (20, 24)


def test_a_map_s_size_and_the_number_of_stuck_pixels_are_said(model: Model, record: Record) -> None:
    biases = np.random.default_rng(7).normal(0, 12, IMAGE).astype(np.float32)
    stuck = np.full(IMAGE, np.nan, dtype=np.float32)
    stuck.flat[::60] = 3000
    hidden = (
        MAKE["fixed_pattern"](map=PixelMap("biases.npy", biases)),
        MAKE["stuck_pixels"](map=PixelMap("stuck.npy", stuck)),
    )
    result = reconcile(model, record(*hidden), Settings(kinds=("fixed_pattern", "stuck_pixels")))
    said = "\n".join(summary_lines(result))
    assert 'stuck_pixels ("stuck_pixels.npy", 8 pixels)' in said
    (size,) = set(re.findall(r'fixed_pattern \("fixed_pattern.npy", ([\d.]+) mm rms\)', said))
    working = biases[np.isnan(stuck)]
    assert abs(float(size) - np.sqrt((working**2).mean())) < 1.5


def test_what_is_left_within_the_tolerance_is_said(model: Model, record: Record) -> None:
    """Poses off by a tenth of sigma, and the numbers beside an offset: not where they are exact."""
    surfaces = tuple(
        replace(s, center_mm=(*s.center_mm[:2], s.center_mm[2] + d))
        for s, d in zip(model.surfaces, (0.4, -0.7, 1.6), strict=True)
    )
    offset = record(MAKE["range_offset"](offset_mm=7.0), seed=14)
    clause = "within the tolerance, which errors do not hold."
    settings = Settings(kinds=("range_offset",))
    assert headline(reconcile(replace(model, surfaces=surfaces), offset, settings)).endswith(clause)
    assert "tolerance" not in headline(reconcile(model, offset, settings))


def test_the_noise_alone_is_called_one_thing_and_other_rounds_are_said(model: Model, record: Record) -> None:
    hidden = record(MAKE["range_offset"](offset_mm=9.0), MAKE["excess_noise"](factor=1.4))
    result = reconcile(model, hidden, Settings(kinds=("range_offset", "excess_noise")))
    assert len(result.named) == 2
    assert "noise alone gives" in headline(result)
    (candidates,) = [line for line in summary_lines(result) if line.startswith("candidates")]
    assert "each alone:" in candidates
    page = render_gap(result, source="x.h5")
    assert "is chance" not in page
    assert "The floor is what noise alone gives" in page
    assert "each effect beside the others: there its numbers and gains differ from those here" in page


def test_zero_is_written_without_a_sign(model: Model, record: Record) -> None:
    result = reconcile(model, record(MAKE["range_offset"](offset_mm=9.0)), Settings(kinds=("range_offset",)))
    (named,) = result.named
    nothing = replace(
        named, effect=MAKE["range_offset"](offset_mm=-0.0), stderr={"offset_mm": 0.2}, heldout_gain_nats=-0.2
    )
    said = replace(result, named=(nothing,))
    assert effect_text(nothing, said) == "range_offset (offset_mm 0.00 +- 0.20)"
    assert "held-out gain 0 nats" in "\n".join(summary_lines(said))
    assert "-0" not in json.dumps(said.as_dict()["effects"]).replace("-0.2", "")
    assert "offset_mm = 0.0" in effect_tables(said)
