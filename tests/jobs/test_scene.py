"""Models of recorded scenes: what is written of a simulated scene is the scene."""

import math
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.planes_found import BOARD_MM, COLS, FACTOR, LAYERS, ROWS, SENSOR, board_and_wall

import tofmix as tm
from tofmix.errors import BadInputError
from tofmix.io.surfaces_file import SurfacesWriter
from tofmix.jobs.reporter import Reporter
from tofmix.jobs.scene import PlaneScene, scene_of_file, write_scene
from tofmix.noise_shape import BackgroundDensity, LearntNoise
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor
from tofmix.sensor_schema import ShareLaw
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.surface import Surface
from tofmix.surfaces.found import SurfacesProvenance, WindowSurfaces

CURVE = NoiseCurve(np.array([500.0, 3000.0]), np.array([4.0, 12.0]))
NOISY = replace(SENSOR, noise=CURVE, integration_time_ms=1.5)
MODEL = """\
[sensor]
profile = "sr3000"
rows = 36
cols = 44
fov_horizontal_deg = 23.5
fov_vertical_deg = 19.5
integration_time_ms = 10.0

[recording]
frames = 60
frame_rate_hz = 20.0

[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3200.0]
size_mm = [4000.0, 3000.0]
yaw_deg = 5.0
reflectivity = 0.9

[[surface]]
name = "board"
center_mm = [-120.0, 60.0, 1800.0]
size_mm = [320.0, 260.0]
yaw_deg = -10.0
pitch_deg = 8.0
roll_deg = 12.0
reflectivity = 0.6
"""


def _written(path: Path, *windows: WindowSurfaces, sensor: Sensor = NOISY) -> Path:
    made = SurfacesProvenance(source="a.layers.h5", source_sha256="ab" * 32, version="9.9", sensor=sensor)
    shape = (len(windows), ROWS, COLS)
    with SurfacesWriter(path, shape=shape, max_layers=LAYERS, factor=FACTOR, provenance=made) as writer:
        for found in windows:
            writer.write(found)
    return path


def _scene(path: Path, *, window: int = 0) -> PlaneScene:
    return scene_of_file(path, Reporter(), window=window, workers=1)


@pytest.fixture(scope="module")
def original() -> Model:
    return parse_model(MODEL, source="boards.toml")


@pytest.fixture(scope="module")
def seen(original: Model) -> Model:
    """The model that is written of a recording of `original`."""
    return tm.scene(tm.simulate(original), workers=1)


def _nearest(original: Surface, model: Model) -> Surface:
    depths = [abs(surface.center_mm[2] - original.center_mm[2]) for surface in model.surfaces]
    return model.surfaces[int(np.argmin(depths))]


def _turn_deg(one: Surface, other: Surface) -> float:
    """Angle between the normals of two surfaces."""
    cosine = abs(float(one.rotation()[:, 2] @ other.rotation()[:, 2]))
    return math.degrees(math.acos(min(1.0, cosine)))


@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
def test_model_of_a_simulated_scene_has_the_surfaces_of_the_original(original: Model, seen: Model) -> None:
    wall, board = original.surfaces
    pixel_rad = np.radians(23.5 / 44)
    found = _nearest(board, seen)
    assert _turn_deg(found, board) < 0.5
    assert found.center_mm == pytest.approx(board.center_mm, abs=0.5 * pixel_rad * 1800.0)
    assert found.size_mm == pytest.approx(board.size_mm, abs=pixel_rad * 1800.0)
    assert found.reflectivity == pytest.approx(board.reflectivity, rel=0.02)
    # The wall fills the image: its plane is known, and not where it ends beyond the image.
    found = _nearest(wall, seen)
    normal = found.rotation()[:, 2]
    assert _turn_deg(found, wall) < 0.2
    assert abs(normal @ np.array(found.center_mm)) == pytest.approx(3200.0 * np.cos(np.radians(5.0)), abs=2.0)
    assert len(seen.surfaces) == 2


def test_model_of_a_simulated_scene_has_the_camera_and_noise_of_the_original(original: Model, seen: Model) -> None:
    was, now = original.sensor, seen.sensor
    assert now.optics == was.optics
    assert (now.shape, now.range_max_mm, now.outlier_probability) == (was.shape, was.range_max_mm, 1e-4)
    ranges = np.linspace(300.0, 7500.0, 50)
    wanted = was.noise_at(10.0).sigma(ranges)
    assert now.noise_at(now.integration_time_ms).sigma(ranges) == pytest.approx(wanted, rel=1e-5)
    assert seen.recording.frames == 60
    assert seen.recording.frame_rate_hz == pytest.approx(20.0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
def test_written_model_is_simulated_and_agrees_with_the_recording_in_reconcile(seen: Model) -> None:
    again = tm.simulate(seen, seed=5)
    assert again.shape == (60, 36, 44)
    assert tm.reconcile(seen, again, noise="model").verified.verdict == "agree"


def test_surfaces_file_becomes_rectangles_with_the_camera_of_the_file(tmp_path: Path) -> None:
    made = _scene(_written(tmp_path / "a.surfaces.h5", board_and_wall()))
    board = made.model.surfaces[0]
    assert board.name == "surface 0"
    assert board.center_mm[2] == pytest.approx(BOARD_MM)
    assert made.model.sensor.noise.same_as(CURVE)
    assert made.model.sensor.integration_time_ms == 1.5
    assert made.values["surfaces"] == 2
    assert made.values["pixels"] == ROWS * COLS
    assert made.values["pixels_changed"] == 0
    assert made.values["notes"] == []


def test_pixels_are_counted_that_a_rectangle_covers_beside_the_outline(tmp_path: Path) -> None:
    found = board_and_wall()
    fine, ranges = found.surface_fine.copy(), found.range_fine.copy()
    fine[4:8, 12:16], ranges[4:8, 12:16] = 1, 2600.0  # a pixel in the board through which the wall is seen
    made = _scene(_written(tmp_path / "a.surfaces.h5", replace(found, surface_fine=fine, range_fine=ranges)))
    assert made.values["pixels_changed"] == 1
    assert "a share changes by more than 0.1 in 1 of 48 pixels" in made.words


def test_smooth_hidden_and_covering_surfaces_are_left_out_and_counted(tmp_path: Path) -> None:
    found = board_and_wall()
    planes = found.planes
    more = replace(
        planes,
        n_pixels=np.append(planes.n_pixels, [9, 9, 9]).astype(np.uint32),
        normal=np.append(planes.normal, [[np.nan] * 3, [0, 0, 1], [0, 0, 1]], axis=0).astype(np.float32),
        offset_mm=np.append(planes.offset_mm, [np.nan, 3000.0, 500.0]).astype(np.float32),
        rms_mm=np.append(planes.rms_mm, [1.0, 1.0, 1.0]).astype(np.float32),
    )
    fine = found.surface_fine.copy()
    fine[0], fine[:, 0] = 4, 4  # an angle along two sides of the image: its rectangle covers all the rest
    fine[16:20, 4:8] = 2
    made = _scene(_written(tmp_path / "a.surfaces.h5", replace(found, planes=more, surface_fine=fine)))
    counts = {key: made.values[f"{key}_surfaces"] for key in ("smooth", "hidden", "covering")}
    assert counts == {"smooth": 1, "hidden": 1, "covering": 1}
    assert [surface.name for surface in made.model.surfaces] == ["surface 0", "surface 1"]
    assert made.words.startswith(
        "2 surfaces; 1 smooth surface left out, no plane; 1 surface left out, nowhere the nearest; 1 left out, of which"
        " a rectangle covers more of others; a share changes by more than 0.1 in "
    )


def test_what_a_model_has_not_is_said_and_written_as_a_remark(tmp_path: Path) -> None:
    density = BackgroundDensity(range_mm=np.array([0.0, 1000.0, 4000.0]), density=np.array([1e-4, 4e-4, 1e-4]))
    law = AmplitudeLaw(
        reference=np.array([900.0, 50.0]), amplitude=np.array([10.0, 2000.0]), factor=np.array([2.0, 0.5])
    )
    curve = replace(CURVE, background_density=density, law=law)
    sensor = replace(NOISY, noise=curve, integration_time_ms=None, range_max_mm=None, share_law=ShareLaw.DETECTIONS)
    made = _scene(_written(tmp_path / "a.surfaces.h5", board_and_wall(), sensor=sensor))
    assert made.model.sensor.noise.law is None
    longest = float(np.ceil(np.nanmax(board_and_wall().range_fine)))
    assert made.model.sensor.range_max_mm == longest
    for words in ("integration_time_ms", "range_max_mm", "share_law", "random values", "noise by amplitude"):
        note = next(note for note in made.values["notes"] if note.startswith(words))
        assert f"# {note}\n" in made.model.text


def test_step_and_memory_of_the_noise_become_effects(tmp_path: Path) -> None:
    learnt = LearntNoise(
        background=None,
        drift_mm=np.zeros(3),
        memory=0.25,
        gain_samples=np.array([10.0]),
        gain_background=np.array([0.0]),
        gain_more=np.zeros((1, 1, 4)),
        gain_first=np.zeros((1, 4)),
    )
    sensor = replace(NOISY, range_step_mm=np.array(5.0), learnt=learnt)
    made = _scene(_written(tmp_path / "a.surfaces.h5", board_and_wall(), sensor=sensor))
    kinds = {effect.kind: effect for effect in made.model.effects}
    assert kinds["quantisation"].step_mm == 5.0  # type: ignore[attr-defined]
    assert kinds["temporal_correlation"].coefficient == 0.25  # type: ignore[attr-defined]


def test_map_of_background_shares_is_written_beside_the_model(tmp_path: Path) -> None:
    shares = np.linspace(0.0, 0.2, ROWS * COLS).reshape(ROWS, COLS)
    sensor = replace(NOISY, noise=replace(CURVE, background=shares))
    source = _written(tmp_path / "a.surfaces.h5", board_and_wall(), sensor=sensor)
    write_scene(source, tmp_path / "scene.toml", Reporter(), window=0, workers=1, overwrite=False)
    assert 'background = "scene.background.npy"' in (tmp_path / "scene.toml").read_text()
    assert np.load(tmp_path / "scene.background.npy") == pytest.approx(shares)
    recording = tm.simulate(tmp_path / "scene.toml", frames=2)
    assert recording.shape == (2, ROWS, COLS)


def test_files_that_tell_no_scene_are_refused_with_the_remedy(tmp_path: Path) -> None:
    without = replace(NOISY, noise=None)
    path = _written(tmp_path / "noise.surfaces.h5", board_and_wall(), sensor=without)
    with pytest.raises(BadInputError, match="no noise curve; estimate its recording with --noise auto"):
        _scene(path)
    blind = replace(NOISY, fov_horizontal_deg=None, fov_vertical_deg=None)
    with pytest.raises(BadInputError, match="field of view"):
        _scene(_written(tmp_path / "view.surfaces.h5", board_and_wall(), sensor=blind))
    found = board_and_wall()
    nowhere = replace(found, surface_fine=np.full_like(found.surface_fine, -1))
    with pytest.raises(BadInputError, match="no plane among its 2 surfaces"):
        _scene(_written(tmp_path / "none.surfaces.h5", nowhere))
    with h5py.File(tmp_path / "other.h5", "w") as root:
        root["speed"] = [1.0]
    with pytest.raises(BadInputError, match="range"):
        _scene(tmp_path / "other.h5")
