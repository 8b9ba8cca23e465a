"""Models and their files: the contract's example, bounds, overriding, defaults, refusals, and the built-in ones."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.sensor import NoiseCurve
from tofmix.sensors import CompleteCamera
from tofmix.simulation import BUILTIN_MODELS, builtin_description, builtin_text
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.model_toml import BACKGROUND_MAP, background_path, parse_model, with_noise
from tofmix.simulation.render import render_blocks
from tofmix.simulation.surface import Surface

BOARD = Surface(name="board", center_mm=(0, 0, 2000), size_mm=(500, 400))


@pytest.mark.parametrize(
    ("yaw", "pitch", "u", "v", "n"),
    [
        (0, 0, (1, 0, 0), (0, 1, 0), (0, 0, 1)),
        (90, 0, (0, 0, -1), (0, 1, 0), (1, 0, 0)),  # right-handed about y: z turns to x, x to -z
        (0, 90, (1, 0, 0), (0, 0, 1), (0, -1, 0)),  # right-handed about x: y turns to z, z to -y
        (90, 90, (0, 1, 0), (0, 0, 1), (1, 0, 0)),  # yaw first: u lies along -z, which pitch turns to y
    ],
)
def test_rotation_is_yaw_about_y_then_pitch_about_x(
    yaw: float, pitch: float, u: tuple[int, ...], v: tuple[int, ...], n: tuple[int, ...]
) -> None:
    np.testing.assert_allclose(replace(BOARD, yaw_deg=yaw, pitch_deg=pitch).rotation().T, [u, v, n], atol=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size_mm": (0.0, 1.0)}, "size_mm: "),
        ({"size_mm": (1.0, float("nan"))}, "size_mm: "),
        ({"size_mm": (1.0, 1e300)}, "size_mm: "),
        ({"center_mm": (0.0, 0.0, float("inf"))}, "center_mm: "),
        ({"yaw_deg": float("nan")}, "yaw_deg: nan is not finite"),
        ({"pitch_deg": float("inf")}, "pitch_deg: "),
        ({"reflectivity": 1.01}, "reflectivity: 1.01 is not in"),
        ({"reflectivity": float("nan")}, "reflectivity: "),
        ({"name": ""}, "name: "),
    ],
)
def test_surface_refuses_values_out_of_bounds(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        replace(BOARD, **change)


@pytest.mark.parametrize("change", [{"frames": 0}, {"seed": -1}, {"frame_rate_hz": 0.0}, {"frame_rate_hz": np.inf}])
def test_recording_settings_refuse_values_out_of_bounds(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(change))}: "):
        RecordingSettings(**change)


def test_model_refuses_two_surfaces_of_one_name(sensor: CompleteCamera) -> None:
    with pytest.raises(ValueError, match='surfaces 1 and 2 are both named "board"'):
        Model(sensor=sensor, surfaces=(BOARD, BOARD))


CONTRACT = """
[sensor]
profile = "sr3000"               # a built-in sensor; every key below overrides it
rows = 144
cols = 176
fov_horizontal_deg = 47.0
fov_vertical_deg = 39.0
range_min_mm = 650.0
range_max_mm = 7500.0
modulation_frequency_hz = 20.0e6 # d_u = c / (2 f), the unambiguous range
integration_time_ms = 1.2
outlier_probability = 1.0e-4     # p(c_r)

[sensor.noise]                   # sigma(r) at reference_integration_time_ms
range_mm = [500.0, 1000.0, 2000.0, 3000.0, 5000.0, 7500.0]
sigma_mm = [3.0, 6.0, 13.0, 24.0, 67.0, 150.0]
reference_integration_time_ms = 10.0
exponent = 0.5                   # sigma(r, tau) = sigma(r) * (reference / tau) ** exponent

[recording]
frames = 100
frame_rate_hz = 25.0
seed = 1

[[surface]]                      # a flat rectangle; as many as wanted
name = "white board"
center_mm = [0.0, 0.0, 3600.0]   # sensor frame: x right, y down, z forward
size_mm = [1200.0, 1000.0]       # width, height
yaw_deg = 0.0                    # about y, applied first
pitch_deg = 0.0                  # about x
reflectivity = 0.8               # 0..1
"""
SHORT = '[sensor]\nprofile = "sr3000"\n'
BOARD_TOML = "[[surface]]\ncenter_mm = [0, 0, 3000]\nsize_mm = [100, 100]\n"


def test_example_of_the_contract_is_read() -> None:
    model = parse_model(CONTRACT, source="model.toml")
    assert model.text == CONTRACT
    assert model.surfaces == (
        Surface(name="white board", center_mm=(0.0, 0.0, 3600.0), size_mm=(1200.0, 1000.0), reflectivity=0.8),
    )
    assert model.recording == RecordingSettings(frames=100, frame_rate_hz=25.0, seed=1)
    assert model.sensor.noise.sigma_mm[0] == 3.0
    assert (model.sensor.rows, model.sensor.cols, model.sensor.integration_time_ms) == (144, 176, 1.2)
    assert model.sensor.default_integration_time_ms == 10.0


def test_keys_come_from_the_file_its_profile_or_the_defaults_and_missing_ones_are_named() -> None:
    model = parse_model(SHORT + "[sensor.noise]\nexponent = 1\n" + BOARD_TOML, source="m")
    assert (model.sensor.name, model.sensor.exponent, model.sensor.integration_time_ms) == ("SR-3000", 1.0, 10.0)
    assert model.sensor.noise.range_mm.size == 6
    assert model.recording == RecordingSettings()
    assert (model.surfaces[0].yaw_deg, model.surfaces[0].name) == (0.0, "surface 1")
    model = parse_model(CONTRACT.replace('profile = "sr3000"', 'name = "mine"'), source="m")
    assert model.sensor.name == "mine"
    assert model.sensor.default_integration_time_ms == 10.0  # the curve's own time
    assert parse_model(CONTRACT.replace('profile = "sr3000"', ""), source="m").sensor.name
    text = CONTRACT.replace('profile = "sr3000"', "").replace("cols = 176", "").replace("exponent = 0.5", "")
    with pytest.raises(BadInputError, match=r'^m: \[sensor\]: missing cols, noise\.exponent; .* profile = "sr3000"'):
        parse_model(text, source="m")
    with pytest.raises(BadInputError, match=r"^m: \[sensor\]: missing rows, cols, fov_horizontal_deg"):
        parse_model("", source="m")


def test_without_a_modulation_frequency_the_camera_measures_no_phase() -> None:
    text = CONTRACT.replace('profile = "sr3000"', "").replace("modulation_frequency_hz", "# modulation_frequency_hz")
    assert parse_model(text, source="m").sensor.modulation_frequency_hz is None
    assert parse_model('[sensor]\nprofile = "stoc"', source="m").sensor.modulation_frequency_hz is None
    given = parse_model('[sensor]\nprofile = "stoc"\nmodulation_frequency_hz = 2e7', source="m")
    assert given.sensor.turn_mm("a test") == pytest.approx(7494.8, abs=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[sensor\n", "m: not a TOML file: Expected ']' at the end of a table declaration (at line 1, column 8)"),
        ("\n\nx = 1 2", "m: not a TOML file: Expected newline or end of document after a statement (at line 3, "),
        ("x = " + "[" * 1900, "m: not a TOML file: "),
        ("x = " + "1" * 1900, 'm: "x" is not a key here'),
        (
            "x = " + "[" * 5000,
            "m: 5004 characters, 5004 in the longest line; no more than 1000000 and 2000 are read; break",
        ),
        ("x = 2001-99-99", "m: not a TOML file: "),
        (SHORT + "[recordng]\n", 'm: "recordng" is not a key here; did you mean "recording"? known: effect, '),
        (SHORT + "row = 3", 'm: [sensor]: "row" is not a key here; did you mean "rows"?'),
        (SHORT + "rows = 3.0", "m: [sensor]: rows: expected a whole number, got a number, 3.0"),
        (SHORT + "rows = true", "m: [sensor]: rows: expected a whole number, got a boolean, true"),
        (SHORT + "rows = 0", "m: [sensor]: rows: 0 is not in 1..4096"),
        (SHORT + "cols = 1000000000", "m: [sensor]: cols: 1000000000 is not in 1..4096"),
        (SHORT + "fov_vertical_deg = 181", "m: [sensor]: fov_vertical_deg: 181 is above 180"),
        (SHORT + "fov_horizontal_deg = -1", "m: [sensor]: fov_horizontal_deg: -1 is not a finite number above 0"),
        (SHORT + "range_min_mm = 7500", "m: [sensor]: range_min_mm: 7500 is not in [0, range_max_mm = 7500)"),
        (SHORT + "range_max_mm = 70000", "m: [sensor]: range_max_mm: 70000 is above 65000"),
        (SHORT + "integration_time_ms = nan", "m: [sensor]: integration_time_ms: expected a finite number, got nan"),
        (SHORT + f"range_max_mm = {10**400}", "m: [sensor]: range_max_mm: expected a finite number, got inf"),
        (SHORT + "range_max_mm = true", "m: [sensor]: range_max_mm: expected a number, got a boolean, true"),
        (SHORT + "range_max_mm = 1979-05-27", "m: [sensor]: range_max_mm: expected a number, got a date or time"),
        (SHORT + "outlier_probability = 1", "m: [sensor]: outlier_probability: 1 is not in [0, 1)"),
        (SHORT + "name = 3", "m: [sensor]: name: expected a string, got a whole number, 3"),
        (SHORT + "noise = 3", "m: [sensor]: noise: expected one table [sensor.noise], got a whole number, 3"),
        (
            SHORT + "[sensor.noise]\nsigma_mm = [1]",
            "m: [sensor.noise]: range and sigma must be two lists of one length",
        ),
        (
            SHORT + "[sensor.noise]\nsigma_mm = 1",
            "m: [sensor.noise]: sigma_mm: expected a list of numbers, got a whole",
        ),
        (SHORT + "[sensor.noise]\nsigma_mm = [1,2,3,4,5,0]", "m: [sensor.noise]: sigma is 0 mm at 7500 mm"),
        (
            SHORT + "[sensor.noise]\nsigma_mm = [1,'2']",
            "m: [sensor.noise]: sigma_mm: expected a number at place 2, got",
        ),
        (SHORT + "[sensor.noise]\nsigm = [1]", 'm: [sensor.noise]: "sigm" is not a key here; did you mean "sigma_mm"'),
        (SHORT + "[sensor.noise]\nexponent = -1", "m: [sensor.noise]: exponent: -1 is not a finite number of at least"),
        (
            SHORT + "integration_time_ms = 1e-9\n[sensor.noise]\nexponent = 99",
            "m: [sensor.noise]: exponent: 99: sigma ",
        ),
        (
            '[sensor]\nprofile = "sr300"',
            'm: [sensor]: profile: "sr300" is not a built-in sensor; did you mean "sr3000"?',
        ),
        ("[sensor]\nprofile = 3", "m: [sensor]: profile: expected a string, got a whole number, 3"),
        ("sensor = 3", "m: sensor: expected one table [sensor], got a whole number, 3"),
        ("[[sensor]]", "m: sensor: expected one table [sensor], got a list"),
        (SHORT + "[recording]\nframes = 0", "m: [recording]: frames: 0 is not at least 1"),
        (SHORT + "[recording]\nframes = 1e2", "m: [recording]: frames: expected a whole number, got a number, 100.0"),
        (SHORT + "[recording]\nseed = -1", "m: [recording]: seed: -1 is not at least 0"),
        (SHORT + "[recording]\nseed = 'a'", 'm: [recording]: seed: expected a whole number, got a string, "a"'),
        (SHORT + "[recording]\nframe_rate_hz = 0", "m: [recording]: frame_rate_hz: 0 is not a finite number above 0"),
        (SHORT + "[recording]\nsed = 1", 'm: [recording]: "sed" is not a key here; did you mean "seed"?'),
        (SHORT + "[surface]\n", "m: surface: expected tables [[surface]], got a table"),
        (SHORT + "[[surface]]\nsize_mm = [1, 1]", "m: [[surface]] 1: center_mm: missing"),
        (SHORT + "[[surface]]\nname = 'a'", "m: [[surface]] 1: center_mm, size_mm: missing"),
        (
            SHORT + BOARD_TOML + BOARD_TOML + "size = 1",
            'm: [[surface]] 2: "size" is not a key here; did you mean "size_mm"?',
        ),
        (
            SHORT + BOARD_TOML.replace("[100, 100]", "[1]"),
            "m: [[surface]] 1: size_mm: expected a list of 2 numbers, got 1",
        ),
        (
            SHORT + BOARD_TOML.replace("[100, 100]", "[1, -1]"),
            "m: [[surface]] 1: size_mm: [1.0, -1.0] are not both above 0",
        ),
        (
            SHORT + BOARD_TOML.replace("3000", "nan"),
            "m: [[surface]] 1: center_mm: expected a finite number at place 3, got nan",
        ),
        (
            SHORT + BOARD_TOML.replace("3000", "1e9"),
            "m: [[surface]] 1: center_mm: [0.0, 0.0, 1000000000.0] are not all within",
        ),
        (SHORT + BOARD_TOML + "reflectivity = 2", "m: [[surface]] 1: reflectivity: 2 is not in [0, 1]"),
        (SHORT + BOARD_TOML + "yaw_deg = '9'", 'm: [[surface]] 1: yaw_deg: expected a number, got a string, "9"'),
        (SHORT + BOARD_TOML + "name = ''", "m: [[surface]] 1: name: it is empty"),
        (
            SHORT + BOARD_TOML + "name = 'a'\n" + BOARD_TOML + "name = 'a'",
            'm: [[surface]]: surfaces 1 and 2 are both named "a"',
        ),
        (SHORT + "[[effect]]\n", "m: [[effect]] 1: kind: missing"),
        (SHORT + "[effect]\n", "m: effect: expected tables [[effect]], got a table"),
    ],
)
def test_refusals_name_file_table_key_value_and_remedy_in_one_line(text: str, message: str) -> None:
    with pytest.raises(BadInputError, match="^" + re.escape(message)) as caught:
        parse_model(text, source="m")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "effect",
    [
        'kind = "wiggling"\namplitude_mm = 1',
        'kind = "scattering"\nshare = 0.1',
        'kind = "pixel_crosstalk"\nshare = 0.1',
        'kind = "flying_pixels"\nprobability = 1',
        'kind = "multipath"\nsurface = "surface 1"\nshare = 0.1\nextra_path_mm = 100',
        'kind = "phase_wrapping"',
    ],
)
def test_effects_on_the_phase_are_refused_for_a_camera_without_one(effect: str) -> None:
    text = f"{BOARD_TOML}\n[[effect]]\n{effect}\n"
    kind = effect.split('"')[1]
    message = f"m: [[effect]] 1: kind: {kind} acts on the phase, and STOC has no modulation_frequency_hz"
    with pytest.raises(BadInputError, match="^" + re.escape(message) + "$"):
        parse_model('[sensor]\nprofile = "stoc"\n' + text, source="m")
    parse_model(SHORT + text, source="m")


def test_other_effects_act_in_a_camera_without_phase() -> None:
    small = "rows = 3\ncols = 3\nfov_horizontal_deg = 1\nfov_vertical_deg = 1\noutlier_probability = 0\n"
    effects = """[[effect]]
kind = "range_offset"
offset_mm = 50
[[effect]]
kind = "phase_wrapping"
unambiguous_range_mm = 2000
"""
    model = parse_model('[sensor]\nprofile = "stoc"\n' + small + BOARD_TOML + effects, source="m")
    block = next(render_blocks(model, cast_scene(model), n_frames=50, seed=1))
    assert block.range_mm[:, 1, 1].mean() == pytest.approx(1050, abs=10)


TEXT = """\
[sensor]
profile = "sr4000"
rows = 4
cols = 6
[sensor.noise]
# of the sheet
range_mm = [
    500.0, 5000.0,
]
sigma_mm = [4.0, 40.0]
[recording]
frames = 20
[[surface]]
center_mm = [0.0, 0.0, 2000.0]
size_mm = [900.0, 900.0]
"""
CURVE = NoiseCurve(np.array([1000.0, 3000.0]), np.array([11.0, 22.0]), width_spread=0.25)


def model(text: str = TEXT) -> Model:
    return parse_model(text, source="a.toml")


@pytest.mark.parametrize(
    "text", [TEXT, TEXT.split("[sensor.noise]", maxsplit=1)[0] + TEXT[TEXT.index("[recording]") :]]
)
def test_text_of_a_model_with_another_noise_is_read_as_this_model(text: str) -> None:
    found = with_noise(model(text), CURVE)
    again = model(found.text)
    for each in (found, again):
        curve = each.sensor.noise_at(each.sensor.integration_time_ms)
        assert curve.sigma_mm.tolist() == [11.0, 22.0]
        assert curve.width_spread == 0.25
    assert again.surfaces == found.surfaces
    assert "of the sheet" not in found.text


@pytest.mark.parametrize(("step_mm", "steps"), [(None, []), (1.0, []), (8.0, [8.0])])
def test_step_above_one_mm_becomes_quantisation(step_mm: float | None, steps: list[float]) -> None:
    found = with_noise(model(), CURVE, step_mm=step_mm)
    for each in (found, model(found.text)):
        assert [e.step_mm for e in each.effects if e.kind == "quantisation"] == steps  # type: ignore[attr-defined]


def test_model_with_another_noise_keeps_its_quantisation_and_names_its_map() -> None:
    own = model(TEXT + '[[effect]]\nkind = "quantisation"\nstep_mm = 5.0\n')
    assert len(with_noise(own, CURVE, step_mm=8.0).effects) == 1
    found = with_noise(model(), replace(CURVE, background=np.full((4, 6), 0.02)))
    assert background_path(found) == BACKGROUND_MAP
    law = "reference_amplitude = [9.0, 9.0]\namplitude = [5.0, 9.0]\namplitude_factor = [2.0, 1.0]\nbackground = 0.1\n"
    given = model(TEXT.replace("sigma_mm = [4.0, 40.0]\n", f"sigma_mm = [4.0, 40.0]\n{law}"))
    again = model(with_noise(given, CURVE).text)
    assert again.sensor.noise.sigma(2000.0, 5.0) == again.sensor.noise.sigma(2000.0, 9.0)
    assert again.sensor.noise.background == 0


def test_noise_in_another_form_than_a_table_is_refused() -> None:
    text = TEXT.replace(
        "[sensor.noise]\n# of the sheet\nrange_mm = [\n    500.0, 5000.0,\n]\nsigma_mm = [4.0, 40.0]\n", ""
    )
    inline = text.replace("cols = 6\n", "cols = 6\nnoise.range_mm = [500.0, 5000.0]\nnoise.sigma_mm = [4.0, 40.0]\n")
    with pytest.raises(BadInputError, match=r"\[sensor.noise\]"):
        with_noise(model(inline), CURVE)


@pytest.mark.parametrize("name", BUILTIN_MODELS)
def test_every_built_in_model_reads_and_is_described_in_one_line(name: str) -> None:
    model = parse_model(builtin_text(name), source=name)
    assert model.text == builtin_text(name)
    assert model.surfaces
    description = builtin_description(name)
    assert 20 < len(description) < 110
    assert not description.startswith("#")


def test_three_boards_are_the_papers(three_boards: tuple[Model, Truth]) -> None:
    model, truth = three_boards
    assert truth.n_modes.shape == (144, 176)
    assert (model.sensor.integration_time_ms, model.recording.frames) == (1.2, 100)
    _, truth = three_boards
    shares = np.nan_to_num(truth.weight_true[:, 92])
    good = (truth.n_modes[:, 92] == 3) & (shares >= 0.1).all(axis=1)
    assert good.sum() >= 40
    assert good[72]  # the paper's pixel, in the middle row
    neighbours = truth.n_modes[good][:, [91, 93]]
    assert set(np.unique(neighbours)) <= {1, 2}
    np.testing.assert_allclose(truth.range_true[good, 92].mean(axis=0), [2400, 3600, 4800], rtol=0.02)
    assert np.ptp(shares[good], axis=0).min() > 0.1  # the shares change from row to row
    _, truth = three_boards
    count = np.bincount(truth.n_modes.ravel(), minlength=4)
    assert count[0] > 1000
    assert count[1] > 10_000
    assert count[2] > 200
    assert ((truth.weight_no_return > 0.1) & (truth.n_modes > 0)).sum() > 50


def test_corridor_has_walls_a_board_in_an_opening_and_open_space() -> None:
    model = parse_model(builtin_text("corridor"), source="corridor")
    truth = cast_scene(model)
    seen = np.unique(truth.surface)
    np.testing.assert_array_equal(seen, np.arange(-1, len(model.surfaces)))
    row = 80
    names = [model.surfaces[k].name if k >= 0 else "open" for k in truth.surface[row, :, 0]]
    order = [name for k, name in enumerate(names) if k == 0 or name != names[k - 1]]
    assert order[0] == "left wall"
    assert order[-1] == "right wall"
    # parallax shows a strip of open space on the board's other side too
    assert order[order.index("board in the opening") :][1:3] == ["open", "end wall, right of the opening"]
    assert (truth.n_modes == 0).sum() > 1000


def cast(name: str) -> tuple[Model, Truth]:
    model = parse_model(builtin_text(name), source=name)
    return model, cast_scene(model)


def test_slanted_wall_near_far_and_corner_have_their_edges_and_creases() -> None:
    model, truth = cast("slanted-wall")
    assert [surface.name for surface in model.surfaces] == ["wall", "board"]
    assert not truth.weight_no_return.any()
    top = truth.range_true[10, :, 0]
    assert (np.diff(top) < 0).all()  # the wall alone, nearer to the right
    assert top[0] - top[-1] > 3000
    step = np.diff(truth.range_true, axis=2)[truth.n_modes == 2]
    assert step.size > 200
    assert step.min() < 1500
    assert step.max() > 3000
    model, truth = cast("near-far")
    assert not truth.weight_no_return.any()
    near, far = (truth.amplitude[(truth.surface == k).any(axis=2) & (truth.n_modes == 1), 0] for k in (0, 1))
    assert 150 < near.mean() / far.mean() < 300
    assert min(near.size, far.size) > 5000
    assert (truth.n_modes == 2).sum() > 200
    assert [surface.name for surface in model.surfaces] == ["bright board", "dark wall"]
    _, truth = cast("corner")
    assert not truth.weight_no_return.any()
    assert set(np.unique(truth.n_modes)) == {1, 2, 3}
    step = np.diff(truth.range_true, axis=2)
    assert np.nanmax(step) < 50
    assert (truth.n_modes > 1).sum() > 200
    np.testing.assert_array_equal(np.unique(truth.surface), [-1, 0, 1, 2])
