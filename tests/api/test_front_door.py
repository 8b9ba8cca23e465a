"""`import tofmix as tm`: recordings, layers, simulations and figures in a few lines; its reference and its types."""

import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, get_args

import h5py
import numpy as np
import pytest
import xarray
from python_page import COMMAND, reference
from support.commandline import succeed
from support.files import boards, write_recording

import tofmix
import tofmix as tm
from tofmix import options
from tofmix.errors import BadInputError, DoubtWarning, UsageError
from tofmix.estimation.settings import MixingChoice, Refine, SigmaMode
from tofmix.io.recording.range_check import UNITS_MM
from tofmix.layers import LAYER_FIELDS
from tofmix.options import Units
from tofmix.sensor import NoiseCurve


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "a.h5", boards(40))


def _without_curve(path: Path) -> Path:
    with h5py.File(path, "r+") as file:
        del file["sensor/noise_range"], file["sensor/noise_sigma"]
    return path


def test_import_tofmix_loads_no_numba_h5py_or_numpy() -> None:
    code = "import sys, tofmix; print(sorted({'numba', 'h5py', 'numpy', 'scipy', 'click'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there_and_unknown_ones_are_refused() -> None:
    for name in tm.__all__:
        assert getattr(tm, name) is not None
        assert name in dir(tm)
    with pytest.raises(AttributeError, match="no attribute 'estimates'"):
        tm.estimates  # noqa: B018


@pytest.mark.slow
def test_function_reconcile_is_not_hidden_by_the_package_of_reconciliation() -> None:
    code = "import tofmix.reconciliation.workflow, tofmix; assert callable(tofmix.reconcile)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")  # what both say is in tests/jobs
def test_estimate_gives_the_values_that_the_command_writes(recording: Path, tmp_path: Path) -> None:
    succeed("estimate", recording, "-o", tmp_path / "command.h5", "--window", 15, "--stride", 10)
    found = tm.estimate(recording, window=15, stride=10)
    command = tm.open(tmp_path / "command.h5")
    assert isinstance(command, tm.Estimate)
    for spec in LAYER_FIELDS:
        np.testing.assert_array_equal(getattr(found, spec.name), getattr(command, spec.name))
    np.testing.assert_array_equal(found.window_stop, command.window_stop)
    assert found.options == command.options
    found.save(tmp_path / "python.h5")
    assert (tmp_path / "python.h5").read_bytes() == (tmp_path / "command.h5").read_bytes()


def test_to_xarray_equals_the_saved_file_opened_with_xarray(recording: Path, tmp_path: Path) -> None:
    found = tm.estimate(recording)
    saved = found.save(tmp_path / "a.layers.h5")
    with xarray.open_dataset(saved, engine="h5netcdf", mask_and_scale=False) as file:
        data = found.to_xarray()
        for name, variable in data.variables.items():
            assert variable.dims == file[name].dims
            assert variable.attrs["units"] == file[name].attrs["units"]
            np.testing.assert_array_equal(variable.values, file[name].values)


def test_recordings_are_saved_and_opened_and_nothing_else(recording: Path, tmp_path: Path) -> None:
    source = tm.open(recording)
    assert isinstance(source, tm.Recording)
    again = tm.open(source.with_sensor(name="mine").save(tmp_path / "b.h5"))
    assert isinstance(again, tm.Recording)
    assert again.sensor.name == "mine"
    np.testing.assert_array_equal(again.range_mm, source.range_mm)
    found = tm.estimate(recording)
    (tmp_path / "there.h5").write_bytes(b"mine")
    with pytest.raises(UsageError, match="exists"):
        found.save(tmp_path / "there.h5")
    assert (tmp_path / "there.h5").read_bytes() == b"mine"
    saved = tm.estimate(recording).save(tmp_path / "a.layers.h5")
    with pytest.raises(BadInputError, match="a layers file, not a recording"):
        tm.estimate(saved)


SCALES: tuple[tuple[Units, float], ...] = (("mm", 1.0), ("cm", 10.0), ("m", 1000.0))


def test_from_array_takes_metres_fill_values_and_masked_ones(recording: Path) -> None:
    source = tm.open(recording)
    assert isinstance(source, tm.Recording)
    ranges = source.range_mm.astype(np.float64)
    layers = [tm.estimate(tm.from_array(ranges / mm, units=unit, sensor=source.sensor)) for unit, mm in SCALES]
    for other in layers[1:]:
        np.testing.assert_allclose(other.range, layers[0].range, rtol=1e-6)
    with pytest.raises(ValueError, match="units: 'inch' is not one of mm, cm, m"):
        tm.from_array(ranges, units="inch")  # type: ignore[arg-type]
    ranges = np.array([[[0, 65535]]] * 5, dtype="u2")
    np.testing.assert_array_equal(tm.from_array(ranges, units="mm", keep_values=True).range_mm, ranges)
    ranges = np.ma.masked_greater(np.array([[[1500.0, 2000.0]]] * 5), 1600.0)
    assert np.isnan(tm.from_array(ranges, units="mm").range_mm).sum(axis=0).tolist() == [[0, 5]]
    ranges = np.ma.array(np.full((6, 2, 2), 900.0), mask=False)
    ranges[0, 0], ranges[1, 0, 0], ranges[2, 1, 1] = 0.0, np.nan, np.inf
    ranges[3, 0, 1] = 1e20  # below the mask: not a fill value that nobody names
    ranges[3] = np.ma.masked
    status = np.full(ranges.shape, 5)
    status[5, 1] = status[0, 0] = 4
    found = tm.from_array(ranges, units="mm", status=status, valid_status=(5,))
    assert found.dropped == {"zero": 2, "NaN": 1, "masked": 4, "infinite": 1, "status": 2}
    assert np.isnan(found.range_mm).sum() == sum(found.dropped.values())
    assert found.with_sensor(name="other").dropped == found.dropped
    assert tm.from_array(np.ones((2, 1, 1)), units="m").dropped == {}


@pytest.mark.parametrize("dtype", ["u2", "f4", "f8"])
def test_from_array_takes_zeros_and_given_values_for_no_samples(dtype: str) -> None:
    ranges = np.full((10, 1, 2), 1200, dtype=dtype)
    ranges[:3, 0, 0], ranges[:4, 0, 1] = 0, 9999
    found = tm.from_array(ranges, units="mm", invalid=(9999,)).range_mm
    assert np.isnan(found).sum(axis=0).tolist() == [[3, 4]]


def test_from_array_turns_depths_along_z_into_ranges_as_import_does(tmp_path: Path) -> None:
    flat = np.full((4, 6, 8), 3000.0)
    with pytest.raises(ValueError, match="give intrinsics or fov_deg"):
        tm.from_array(flat, units="mm", depth_axis="z")
    np.save(tmp_path / "a.npy", flat)
    lenses: tuple[tuple[str, dict[str, Any]], ...] = (
        ("--intrinsics=9,8,3.5,2.5", {"intrinsics": (9.0, 8.0, 3.5, 2.5)}),
        ("--fov=70x55", {"fov_deg": (70.0, 55.0)}),
    )
    for option, lens in lenses:
        done = tm.from_array(flat, units="mm", depth_axis="z", **lens)
        succeed("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--overwrite", "--depth-axis", "z", option)
        imported = tm.open(tmp_path / "a.h5")
        assert isinstance(imported, tm.Recording)
        np.testing.assert_array_equal(done.range_mm, imported.range_mm)
        assert done.sensor.projection == imported.sensor.projection
        along = tm.from_array(flat, units="mm", **lens)
        assert (along.range_mm == 3000.0).all()
        assert along.sensor.optics is not None


def test_from_array_says_or_refuses_what_no_camera_measures() -> None:
    with pytest.warns(DoubtWarning, match=r"^from_array: no valid sample: 24 zero$"):
        tm.from_array(np.zeros((4, 2, 3)), units="mm")
    with pytest.warns(DoubtWarning, match=r"half of the ranges are above 1500 m; .*: units='mm'"):
        tm.from_array(np.full((5, 1, 1), 1500.0), units="m")
    matrix = np.array([[310.5, 0.0, 160.0], [0.0, 311.0, 120.0], [0.0, 0.0, 1.0]])
    for array in (matrix[np.newaxis], matrix):
        with pytest.raises(ValueError, match="is a camera matrix, not ranges"):
            tm.from_array(array, units="mm")


@pytest.mark.parametrize(
    "times",
    [
        np.datetime64("2023-11-05T10:00:00", "ms") + np.arange(4) * np.timedelta64(40, "ms"),
        np.arange(4) * np.timedelta64(40, "ms"),
        [datetime(2023, 11, 5, 10, tzinfo=UTC).replace(tzinfo=None) + k * timedelta(milliseconds=40) for k in range(4)],
        [datetime(2023, 11, 5, 10, tzinfo=UTC) + k * timedelta(milliseconds=40) for k in range(4)],
        [f"2023-11-05 10:00:00.{40 * k:03d}" for k in range(4)],
    ],
)
def test_from_array_takes_dates_as_times(times: Any) -> None:  # noqa: ANN401  of several types
    found = tm.from_array(np.full((4, 1, 1), 800.0), units="mm", time_s=times).time_s
    assert found is not None
    np.testing.assert_allclose(found, [0.0, 0.04, 0.08, 0.12], atol=1e-9)


@pytest.mark.filterwarnings("ignore:from_array.*for this image")
def test_from_array_with_a_built_in_camera_has_the_noise_of_the_given_integration_time() -> None:
    stack = np.full((5, 1, 1), 1200.0)
    fast, slow = (tm.from_array(stack, units="mm", sensor="sr3000", integration_time_ms=tau) for tau in (1.2, 4.8))
    assert fast.sensor.noise is not None
    assert slow.sensor.noise is not None
    np.testing.assert_allclose(fast.sensor.noise.sigma_mm, 2.0 * slow.sensor.noise.sigma_mm)


@pytest.mark.slow
def test_recording_without_a_curve_is_estimated_with_the_measured_one(tmp_path: Path) -> None:
    path = _without_curve(write_recording(tmp_path / "a.h5", boards(100, rows=12, cols=24)))
    found = tm.estimate(path)
    assert found.options["noise"] == "auto"
    assert found.sensor.noise is not None
    with pytest.raises(BadInputError, match="no noise curve; measure it with noise='auto'"):
        tm.estimate(path, noise="file")


@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")  # neither is the recording's
@pytest.mark.slow
def test_noise_can_be_a_curve_or_a_built_in_camera(recording: Path) -> None:
    curve = NoiseCurve(np.array([1000.0]), np.array([33.0]))
    assert tm.estimate(recording, noise=curve, sigma="tied").sigma[0, 0, 0, 0] == pytest.approx(33.0)
    assert tm.estimate(recording, noise="sr3000").sensor.noise is not None
    with pytest.raises(ValueError, match="unknown profile 'sr9000'; choose file, auto or one of"):
        tm.estimate(recording, noise="sr9000")


def test_options_of_learnt_noise_need_learnt_noise(recording: Path) -> None:
    with pytest.raises(ValueError, match=r"^noise_widths='own' needs learnt noise; paper=True uses a Gaussian curve"):
        tm.estimate(recording, noise_widths="own", paper=True)
    with pytest.raises(ValueError, match=r"^noise_shape='gaussian' needs learnt noise; noise='sr3000' uses"):
        tm.estimate(recording, noise_shape="gaussian", noise="sr3000")
    with pytest.raises(ValueError, match=r"^noise_shape: 'round' is not one of gaussian, auto$"):
        tm.estimate(recording, noise_shape="round")  # type: ignore[arg-type]


@pytest.mark.slow
def test_simulate_gives_the_samples_that_the_command_writes(tmp_path: Path) -> None:
    succeed("simulate", "near-far", "-o", tmp_path / "s.h5", "--frames", 5, "--seed", 3)
    command = tm.open(tmp_path / "s.h5")
    assert isinstance(command, tm.Recording)
    memory = tm.simulate("near-far", frames=5, seed=3)
    np.testing.assert_array_equal(memory.range_mm, command.range_mm)
    np.testing.assert_array_equal(memory.amplitude, command.amplitude)
    np.testing.assert_array_equal(memory.time_s, command.time_s)
    assert memory.truth is not None
    assert memory.truth.n_modes.shape == memory.shape[1:]


def test_plot_draws_a_pixel_and_the_whole_image_and_refuses_pixels_that_are_not_there(recording: Path) -> None:
    found = tm.estimate(recording)
    png = b"\x89PNG"
    one = tm.plot(found, pixel=(1, 3), neighbours=1)
    assert len([axes for axes in one.axes if axes.get_visible()]) == 2
    assert one._repr_png_().startswith(png)  # type: ignore[attr-defined]  # what a notebook calls
    assert tm.plot(found)._repr_png_().startswith(png)  # type: ignore[attr-defined]
    with pytest.raises(IndexError, match="rows 0 to 3 and columns 0 to 5"):
        tm.plot(found, pixel=(4, 0))
    with pytest.raises(IndexError, match="windows 0 to 0"):
        tm.plot(found, window=1)


def test_reconcile_of_a_model_with_its_own_simulation_agrees() -> None:
    small = Path(__file__).parent.parent.parent / "sample_data" / "three_boards_model.toml"
    measured = tm.simulate(small, frames=60, seed=4)
    assert tm.reconcile(small, measured, effects=("range_offset",)).verified.verdict == "agree"
    with pytest.raises(ValueError, match='effects: "wobble" is not an effect'):
        tm.reconcile(small, measured, effects=("wobble",))


def test_estimate_warns_where_the_curve_is_not_that_of_the_samples(recording: Path) -> None:
    wrong = NoiseCurve(np.array([1000.0]), np.array([150.0]))
    wide = write_recording(recording.with_name("wide.h5"), boards(60, rows=12, cols=24))
    with pytest.warns(DoubtWarning) as said:
        tm.estimate(wide, noise=wrong)
    texts = [str(warning.message) for warning in said]
    assert texts[0].startswith("Samples scatter 0.098 times as much")
    assert texts[1].startswith("Sigma is 0.68 times the sensor's curve")
    assert all(text.endswith("noise='auto' measures it.") for text in texts[:2])


def test_recording_marked_as_averaged_is_refused_unless_forced(tmp_path: Path) -> None:
    averaged = tm.simulate("near-far", frames=3, averaged=True)
    with pytest.raises(BadInputError, match="marked as averaged"):
        tm.estimate(averaged)
    saved = tm.open(averaged.save(tmp_path / "averaged.h5"))
    assert isinstance(saved, tm.Recording)
    assert saved.averaged
    assert tm.estimate(saved, force=True).n_modes.shape == (1, *saved.shape[1:])


@pytest.mark.slow
def test_estimate_warns_of_close_layers_and_of_shares_of_detections(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    near = rng.random((100, 8, 8)) < 0.5
    close = np.where(near, 1500.0, 1570.0) + rng.normal(0.0, 20.0, near.shape)  # 3.5 sigma apart
    curve = NoiseCurve(np.array([1000.0]), np.array([20.0]))
    with pytest.warns(DoubtWarning, match=r"two layers within 5 sigma .* Take a shorter window, or noise='auto'\."):
        tm.estimate(tm.from_array(close, units="mm", noise=curve))
    path = tmp_path / "zones.h5"
    with h5py.File(path, "w") as root:
        root["range"] = np.stack([rng.normal(1500.0, 20.0, (40, 8, 8)), rng.normal(2500.0, 20.0, (40, 8, 8))], axis=1)
        root["range"].attrs["units"] = "mm"
        for axis, name in enumerate(("frame", "target", "row", "col")):
            root[name] = np.arange(root["range"].shape[axis])
            root[name].make_scale(name)
            root["range"].dims[axis].attach_scale(root[name])
    with pytest.warns(DoubtWarning, match="A share is the share of its detections"):
        tm.estimate(path)


def test_open_warns_of_many_exact_zeros(tmp_path: Path) -> None:
    samples = boards(40, dtype="f4")
    samples[::4] = 0.0
    path = write_recording(tmp_path / "zeros.h5", samples, units="mm")
    with pytest.warns(DoubtWarning, match=r"zeros\.h5: range: 240 of 960 checked samples are exactly 0"):
        tm.open(path)


PAGE = Path(__file__).parents[2] / "docs/reference/python.md"


def test_reference_is_what_the_command_prints_with_a_heading_a_name_and_an_item_a_parameter() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference(), f"run: {COMMAND}"
    headings = {
        line.lstrip("# ").removeprefix("tofmix.") for line in reference().splitlines() if line.startswith("###")
    }
    assert set(tofmix.__all__) - {"__version__"} <= headings
    assert '- `units`, {"mm", "cm", "m"}: Unit of `ranges`.' in reference()
    assert "numpy.ndarray" not in reference()


def test_the_names_for_type_checkers_are_those_that_the_program_takes() -> None:
    assert set(get_args(options.Sigma)) == set(SigmaMode)
    assert set(get_args(options.Refine)) == set(Refine)
    assert set(get_args(options.Mixing)) == set(MixingChoice)
    assert set(get_args(options.Units)) == set(UNITS_MM)


def test_type_checkers_find_the_types_of_the_package() -> None:
    """What mypy makes of them, `typed_calls` holds."""
    assert (Path(tofmix.__file__).parent / "py.typed").is_file()
