"""docs/reference/effects.md is what the registry says, and the figures that it calls physics follow from formulas."""

import math
from pathlib import Path

import pytest
from effects_page import COMMAND, reference

from tofmix.circle import SPEED_OF_LIGHT_MM_S, unambiguous_range_mm
from tofmix.simulation.effects import EFFECTS

DOCS = Path(__file__).parents[3] / "docs"
TURN = unambiguous_range_mm(20e6)


def test_effects_page_is_what_the_command_prints() -> None:
    assert (DOCS / "reference/effects.md").read_text(encoding="utf-8") == reference(), f"run: {COMMAND}"


def test_every_effect_has_its_picture() -> None:
    pictures = {kind: DOCS / "images" / "effects" / f"{kind}.png" for kind in EFFECTS}
    missing = [kind for kind, path in pictures.items() if not path.is_file() or path.stat().st_size < 5000]
    assert not missing, f"run: python docs/figures/effect_figures.py {' '.join(missing)}"


def test_every_effect_states_its_typical_magnitudes_and_their_basis() -> None:
    bases = ("physics", "reported", "assumed")
    silent = [k for k, e in EFFECTS.items() if not e.typical or not any(word in e.basis for word in bases)]
    assert not silent, f"typical, and a basis of {bases}"


def test_every_effect_is_drawn_by_the_command() -> None:
    text = (DOCS / "figures/effect_figures.py").read_text(encoding="utf-8")
    missing = [kind for kind in EFFECTS if f'"{kind}": Signature(' not in text]
    assert not missing, "add a Signature to docs/figures/effect_figures.py"


@pytest.mark.parametrize(
    ("kind", "shown", "value"),
    [
        ("wiggling", "12 mm", TURN * 0.01 / (2 * math.pi)),
        ("wiggling", "60 mm", TURN * 0.05 / (2 * math.pi)),
        ("wiggling", "1.874 m", TURN / 4 / 1000),
        ("tap_mismatch", "6 mm", TURN * 0.01 / (4 * math.pi)),
        ("tap_mismatch", "12 mm", TURN * 0.01 / (4 * math.pi * 0.5)),
        ("range_offset", "67 ps", 2 * 10 / SPEED_OF_LIGHT_MM_S * 1e12),
        (
            "multipath",
            "44 mm",
            TURN
            / (2 * math.pi)
            * math.atan2(0.1 * math.sin(math.pi * 1000 / TURN), 1 + 0.1 * math.cos(math.pi * 1000 / TURN)),
        ),
        ("phase_wrapping", "7.495 m", TURN / 1000),
        ("interference", "120 mm", TURN / (2 * math.pi) * math.asin(0.1)),
        ("vignetting", "1.8", (math.cos(math.radians(47 / 2)) * math.cos(math.radians(39 / 2))) ** -4),
        ("excess_noise", "2", math.sqrt(4)),
        *(("quantisation", f"{step}", TURN / 2**bits) for step, bits in ((1.8, 12), (7.3, 10), (29, 8))),
    ],
)
def test_figures_of_physics_follow_from_their_formula(kind: str, shown: str, value: float) -> None:
    number = shown.split(maxsplit=1)[0]
    assert number in EFFECTS[kind].typical
    assert "physics" in EFFECTS[kind].basis
    digits = len(number.replace(".", "").strip("0"))
    assert float(number) == pytest.approx(value, rel=0.5 * 10 ** (1 - digits))
