"""The registry: the contract's kinds, one declaration for all, zero magnitudes, and one more effect in one class."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from support.effect_bench import Bench, effect, neutral_values

from tofmix.errors import BadInputError
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects import EFFECTS, Effect, Level
from tofmix.simulation.effects.base import Context
from tofmix.simulation.effects.parameter import Holds, number
from tofmix.simulation.exposure import predict
from tofmix.simulation.model_toml import explain, parse_model

CONTRACT = {
    "range_offset": "offset_mm",
    "surface_offset": "surface offset_mm",
    "surface_pose": "surface shift_mm yaw_deg pitch_deg roll_deg",
    "wiggling": "amplitude_mm phase_rad harmonics",
    "tap_mismatch": "amplitude_1_mm phase_1_rad amplitude_2_mm phase_2_rad",
    "amplitude_walk": "scale_mm reference_amplitude exponent saturation_amplitude",
    "temperature_drift": "amplitude_mm time_constant_s amplitude_2_mm time_constant_2_s",
    "smooth_pattern": "radial_2_mm radial_4_mm across_mm down_mm across_2_mm down_2_mm",
    "fixed_pattern": "pixel_sigma_mm column_sigma_mm row_sigma_mm map",
    "scattering": "share",
    "internal_reflection": "amplitude range_mm",
    "near_return": "share range_mm sigma_mm",
    "multipath": "surface share extra_path_mm from lamp_falloff",
    "phase_wrapping": "unambiguous_range_mm",
    "flying_pixels": "probability",
    "excess_noise": "factor surface map angle_exponent spot_across spot_down spot_radius_across spot_radius_down",
    "vignetting": "corner_factor",
    "outliers": "probability",
    "stuck_pixels": "share value_mm map",
    "dropout": "probability threshold threshold_noise",
    "temporal_correlation": "coefficient",
    "interference": (
        "probability sigma_mm burst_frames period_frames spot_across spot_down spot_radius_across spot_radius_down map"
    ),
    "saturation": "full_well_amplitude",
    "motion": "surface velocity_mm_s",
    "quantisation": "step_mm",
    "pixel_crosstalk": "share",
}
NOT_ZERO: dict[str, dict[str, Any]] = {
    "surface_pose": {"surface": "near"},
    "surface_offset": {"surface": "near"},
    "motion": {"surface": "near"},
    "multipath": {"surface": "near", "extra_path_mm": 1000},
    "internal_reflection": {"range_mm": 20},
    "near_return": {"range_mm": 25, "sigma_mm": 5},
    "wiggling": {"phase_rad": 1},
    "amplitude_walk": {"reference_amplitude": 100},
    "temperature_drift": {"time_constant_s": 10},
    "phase_wrapping": {"unambiguous_range_mm": 65_000},
    "interference": {"burst_frames": 3},
    "dropout": {"threshold_noise": 10},
}
MODEL = '[sensor]\nprofile = "sr3000"\n[[surface]]\nname = "board"\ncenter_mm = [0, 0, 3000]\nsize_mm = [900, 900]\n'


def table(kind: str, **values: object) -> str:
    shown = {key: f'"{value}"' if isinstance(value, str) else value for key, value in values.items()}
    return f'[[effect]]\nkind = "{kind}"\n' + "".join(f"{key} = {value}\n" for key, value in shown.items())


def test_registry_has_the_kinds_and_parameters_of_the_contract() -> None:
    text = "add the kind to CONTRACT, with its parameters; to NOT_ZERO, where a needed one may not be 0 or has no unit"
    assert set(EFFECTS) == set(CONTRACT), text
    said = {kind: " ".join(p.key for p in cls.parameters().values()) for kind, cls in EFFECTS.items()}
    assert said == CONTRACT, "CONTRACT in tests/simulation/effects/test_registry.py has other parameters"


@pytest.mark.parametrize("kind", CONTRACT)
def test_each_effect_describes_itself_and_its_parameters(kind: str) -> None:
    effect = EFFECTS[kind]
    assert effect.kind == kind
    assert len(effect.__doc__ or "") > 300
    assert effect.signature
    assert effect.predicts
    for parameter in effect.parameters().values():
        assert parameter.sentence.endswith(".")
        assert parameter.holds is not Holds.NUMBER or parameter.unit
        assert (
            parameter.required
            or parameter.default is not None
            or parameter.name
            in {
                "map",
                "unambiguous_range_mm",
                "harmonics",
                "time_constant_2_s",
                "period_frames",
                "extra_path_mm",
                "spot_across",
                "spot_down",
                "spot_radius_across",
                "spot_radius_down",
            }
        )


@pytest.mark.parametrize("kind", CONTRACT)
def test_at_zero_magnitude_the_recording_is_the_one_without_the_effect(bench: Bench, kind: str) -> None:
    """Bit by bit: every effect draws from a stream of its own."""
    plain = bench.boards(frames=30)
    values = neutral_values(EFFECTS[kind]) | NOT_ZERO.get(kind, {})
    missing = {name for name, p in EFFECTS[kind].parameters().items() if p.required} - set(values)
    assert not missing, f"add to NOT_ZERO in tests/simulation/effects/test_registry.py, under {kind}: {missing}"
    other = bench.boards(effect(kind, **values), frames=30)
    np.testing.assert_array_equal(other.stored, plain.stored)
    np.testing.assert_array_equal(other.amplitude, plain.amplitude)


def test_an_effect_more_changes_no_draw_of_the_others(bench: Bench) -> None:
    dropout, outliers = effect("dropout", probability=0.3), effect("outliers", probability=0.2)
    both, one = bench.boards(dropout, outliers), bench.boards(dropout)
    wild = (both.amplitude == 0) & (one.amplitude > 0)
    np.testing.assert_array_equal(both.stored[~wild & (both.amplitude > 0)], one.stored[~wild & (both.amplitude > 0)])
    assert ((one.stored == 0) & (one.amplitude > 0) & (both.stored == 0)).sum() > 100


@pytest.mark.parametrize("kind", CONTRACT)
def test_bounds_are_refused_with_value_and_bound(kind: str) -> None:
    bounded = [p for p in EFFECTS[kind].parameters().values() if p.holds is Holds.NUMBER]
    assert bounded
    for parameter in bounded:
        needed = {
            p.name: "board" if p.holds is Holds.SURFACE else (p.zero or p.low or 1)
            for p in EFFECTS[kind].parameters().values()
            if p.required
        }
        value = parameter.high * 2 + 1
        text = MODEL + table(kind, **(needed | {parameter.name: value}))
        message = f"m: [[effect]] 1: {parameter.name}: {value:g} is not in {parameter.bounds}"
        with pytest.raises(BadInputError, match="^" + re.escape(message) + "$"):
            parse_model(text, source="m")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table("wigling"), 'm: [[effect]] 1: kind: "wigling" is not an effect; did you mean "wiggling"? known: '),
        (table("range_offset"), "m: [[effect]] 1: offset_mm: missing"),
        (table("temperature_drift"), "m: [[effect]] 1: amplitude_mm, time_constant_s: missing"),
        (table("range_offset", offset=3), 'm: [[effect]] 1: "offset" is not a key here; did you mean "offset_mm"?'),
        (table("range_offset", offset_mm="a"), "m: [[effect]] 1: offset_mm: expected a number, got a string"),
        (
            table("motion", surface="bord", velocity_mm_s=1),
            'm: [[effect]] 1: surface: "bord" is not a surface of this model; did you mean "board"? known: board',
        ),
        (
            table("dropout", probability=0.1) + table("dropout", probability=0.2),
            "m: [[effect]] 2: kind: dropout is [[effect]] 1 already; a kind may be there twice only with another",
        ),
        (
            table("motion", surface="board", velocity_mm_s=1) * 2,
            'm: [[effect]] 2: kind: motion of "board" is [[effect]] 1 already',
        ),
        (
            table("wiggling", amplitude_mm=1, harmonics=[8, 5]),
            "m: [[effect]] 1: harmonics: expected a list of lists of numbers, got a list",
        ),
        (
            table("wiggling", amplitude_mm=1, harmonics=[[8, 5]]),
            "m: [[effect]] 1: harmonics: expected lists of three finite numbers, got [8.0, 5.0]",
        ),
        (
            table("wiggling", amplitude_mm=1, harmonics=[[8, 5, "a"]]),
            "m: [[effect]] 1: harmonics: expected a number at place 3 of list 1, got a string",
        ),
        (
            table("wiggling", amplitude_mm=1, harmonics=[[8, 5, 7]]),
            "m: [[effect]] 1: harmonics: 7 rad is not in [-6.28319, 6.28319]",
        ),
        (
            table("wiggling", amplitude_mm=1, harmonics=[[8, 5, 1], [8, 2, 1]]),
            "m: [[effect]] 1: harmonics: 8 periods twice",
        ),
        (
            table("wiggling", amplitude_mm=1, harmonics=[[8, 5, 1], [12, 2, 1], [16, 1, 0]]),
            "m: [[effect]] 1: harmonics: expected at most 2 lists of three numbers",
        ),
        (
            table("temperature_drift", amplitude_mm=1, time_constant_s=9, amplitude_2_mm=2),
            "m: [[effect]] 1: time_constant_2_s: missing, and amplitude_2_mm is not 0",
        ),
        (table("outliers", probability=0.9999), "m: [[effect]] 1: probability: 0.9999 is not below 0.9999"),
        (table("fixed_pattern", map="a.npy"), "m: [[effect]] 1: map: a model without a file of its own has no maps"),
    ],
)
def test_effect_tables_are_refused_with_key_value_and_remedy(text: str, message: str) -> None:
    with pytest.raises(BadInputError, match="^" + re.escape(message)) as caught:
        parse_model(MODEL + text, source="m")
    assert "\n" not in str(caught.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ripple(Effect):
    """One effect more: a ripple from row to row."""

    kind: ClassVar[str] = "ripple"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias against row"

    height_mm: float = number("Largest bias.", unit="mm", low=0, high=100, zero=0)

    def explain(self) -> str:
        return f"rows ripple by {self.height_mm:g} mm"

    def act(self, echoes: Echoes, context: Context) -> None:
        row = np.arange(echoes.shape[-1]) // context.sensor.cols
        echoes.add_bias(self.height_mm * np.sin(row))


def test_one_more_effect_is_one_class_and_one_line(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is parsed, refused, explained, simulated and predicted."""
    monkeypatch.setitem(EFFECTS, "ripple", Ripple)
    with pytest.raises(BadInputError, match=r"height_mm: 101 is not in \[0, 100\]$"):
        parse_model(MODEL + table("ripple", height_mm=101), source="m")
    model = parse_model(MODEL + table("ripple", height_mm=40), source="m")
    assert "range: ripple: rows ripple by 40 mm" in explain(model)
    plain, other = bench.wall(), bench.wall(*model.effects)
    expected = 40 * np.sin(np.arange(240) // 40)
    np.testing.assert_allclose(other.range_mm - plain.range_mm, np.broadcast_to(expected, (20, 240)), atol=1)
    np.testing.assert_allclose(predict(other.model).range_mm[0] - plain.true_mm, expected, atol=1e-3)


def test_every_effect_is_explained_with_its_values() -> None:
    text = MODEL
    for kind, cls in EFFECTS.items():
        values = {
            p.name: "board" if p.holds is Holds.SURFACE else min(0.125, p.high) if p.low < 0.125 else p.low
            for p in cls.parameters().values()
            if p.required
        }
        text += table(kind, **values | ({"extra_path_mm": 900} if kind == "multipath" else {}))
    lines = explain(parse_model(text, source="m")).splitlines()
    named = [line.split(": ")[1] for line in lines if line.startswith("  ")]
    assert sorted(named) == sorted(EFFECTS)
    assert 'motion: "board" moves along its normal at +0.125 mm/s' in "\n".join(lines)
    levels = [line.split(":")[0].strip() for line in lines if line.startswith("  ")]
    assert list(dict.fromkeys(levels)) == ["geometry", "light", "correlation", "range", "read-out"]


def test_each_effect_has_its_own_file() -> None:
    import tofmix.simulation.effects as package

    folder = Path(package.__file__).parent
    assert {path.stem for path in folder.glob("*.py")} >= set(EFFECTS)
