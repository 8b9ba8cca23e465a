"""Model files: the contract's own example, overriding, defaults, and every refusal in one line."""

import re

import pytest

from tofmix.errors import BadInputError
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import RecordingSettings
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.render import render_blocks
from tofmix.simulation.surface import Surface

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
BOARD = "[[surface]]\ncenter_mm = [0, 0, 3000]\nsize_mm = [100, 100]\n"


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


def test_a_model_without_a_profile_gives_every_key_itself() -> None:
    model = parse_model(CONTRACT.replace('profile = "sr3000"', 'name = "mine"'), source="m")
    assert model.sensor.name == "mine"
    assert model.sensor.default_integration_time_ms == 10.0  # the curve's own time
    assert parse_model(CONTRACT.replace('profile = "sr3000"', ""), source="m").sensor.name


def test_without_a_profile_missing_keys_are_named() -> None:
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


def test_keys_left_out_come_from_the_profile_and_the_defaults() -> None:
    model = parse_model(SHORT + "[sensor.noise]\nexponent = 1\n" + BOARD, source="m")
    assert (model.sensor.name, model.sensor.exponent, model.sensor.integration_time_ms) == ("SR-3000", 1.0, 10.0)
    assert model.sensor.noise.range_mm.size == 6
    assert model.recording == RecordingSettings()
    assert (model.surfaces[0].yaw_deg, model.surfaces[0].name) == (0.0, "surface 1")


def test_model_without_surfaces_is_accepted() -> None:
    assert parse_model(SHORT, source="m").surfaces == ()
    assert parse_model("surface = []\neffect = []\n" + SHORT, source="m").surfaces == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[sensor\n", "m: not a TOML file: Expected ']' at the end of a table declaration (at line 1, column 8)"),
        ("\n\nx = 1 2", "m: not a TOML file: Expected newline or end of document after a statement (at line 3, "),
        ("x = " + "[" * 1900, "m: not a TOML file: "),
        ("x = " + "1" * 1900, 'm: "x" is not a key here'),
        ("x = " + "[" * 5000, "m: 5004 characters, 5004 in the longest line; no more than 1000000 and 2000 are read"),
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
        (SHORT + BOARD + BOARD + "size = 1", 'm: [[surface]] 2: "size" is not a key here; did you mean "size_mm"?'),
        (SHORT + BOARD.replace("[100, 100]", "[1]"), "m: [[surface]] 1: size_mm: expected a list of 2 numbers, got 1"),
        (SHORT + BOARD.replace("[100, 100]", "[1, -1]"), "m: [[surface]] 1: size_mm: [1.0, -1.0] are not both above 0"),
        (
            SHORT + BOARD.replace("3000", "nan"),
            "m: [[surface]] 1: center_mm: expected a finite number at place 3, got nan",
        ),
        (
            SHORT + BOARD.replace("3000", "1e9"),
            "m: [[surface]] 1: center_mm: [0.0, 0.0, 1000000000.0] are not all within",
        ),
        (SHORT + BOARD + "reflectivity = 2", "m: [[surface]] 1: reflectivity: 2 is not in [0, 1]"),
        (SHORT + BOARD + "yaw_deg = '9'", 'm: [[surface]] 1: yaw_deg: expected a number, got a string, "9"'),
        (SHORT + BOARD + "name = ''", "m: [[surface]] 1: name: it is empty"),
        (SHORT + BOARD + "name = 'a'\n" + BOARD + "name = 'a'", 'm: [[surface]]: surfaces 1 and 2 are both named "a"'),
        (SHORT + "[[effect]]\n", "m: [[effect]] 1: kind: missing"),
        (SHORT + "[effect]\n", "m: effect: expected tables [[effect]], got a table"),
    ],
)
def test_refusals_name_file_table_key_value_and_remedy_in_one_line(text: str, message: str) -> None:
    with pytest.raises(BadInputError, match="^" + re.escape(message)) as caught:
        parse_model(text, source="m")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ['"a\\nb" = 1', SHORT + BOARD + '"\\u0000\\n" = 1', '[sensor]\nprofile = "a\\nb"'])
def test_strange_names_stay_on_one_line(text: str) -> None:
    with pytest.raises(BadInputError) as caught:
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
    text = f"{BOARD}\n[[effect]]\n{effect}\n"
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
    model = parse_model('[sensor]\nprofile = "stoc"\n' + small + BOARD + effects, source="m")
    block = next(render_blocks(model, cast_scene(model), n_frames=50, seed=1))
    assert block.range_mm[:, 1, 1].mean() == pytest.approx(1050, abs=10)
