"""What holds for `estimate` from file to file, whatever the recording and the options: hypothesis draws both."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.files import write_recording

from tofmix.errors import UsageError
from tofmix.estimation.peaks.counters import COUNTERS
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode
from tofmix.flags import Status
from tofmix.grid import plan_windows
from tofmix.io.layers.layers_file import open_layers
from tofmix.io.recording.recording_file import open_recording
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.pipeline.job import LocalEngine, plan_job
from tofmix.pipeline.run import run_job

TIMES = int(os.environ.get("TOFMIX_TEST_EXAMPLES_TIMES", "1"))
"""The long run asks for more examples, drawn at random."""

MEMORY_BYTES = 400_000_000
RANGE_MAX_MM = 7500.0


def examples(count: int) -> settings:
    """So many examples, the same ones every time, or more of them at random."""
    return settings(
        max_examples=count * TIMES,
        derandomize=TIMES == 1,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


@dataclass(frozen=True)
class Storage:
    """How samples lie in a file."""

    dtype: str = "f4"
    fill: float | None = None
    chunks: tuple[int, int, int] | None = None
    compression: str | None = None
    fletcher32: bool = False
    shuffle: bool = False

    def write(self, path: Path, samples: NDArray[np.float64]) -> Path:
        """Write whole mm and NaN as this storage can: NaN becomes its fill value."""
        whole = np.dtype(self.dtype).kind != "f"
        none = 0.0 if self.fill is None else self.fill
        values = np.where(np.isnan(samples), none if whole or self.fill is not None else np.nan, samples)
        if self.chunks is None:
            return write_recording(path, values.astype(self.dtype), fill=self.fill, units="mm")
        chunks = tuple(min(a, b) for a, b in zip(self.chunks, samples.shape, strict=True))
        return write_recording(
            path,
            values.astype(self.dtype),
            fill=self.fill,
            units="mm",
            chunks=chunks,
            compression=self.compression,
            fletcher32=self.fletcher32,
            shuffle=self.shuffle,
        )


STORAGES = st.builds(
    Storage,
    dtype=st.sampled_from(["u2", ">u2", "u4", "i4", "i8", "f4", ">f4", "f8"]),
    fill=st.sampled_from([None, 0.0, 65535.0]),
    chunks=st.none() | st.tuples(st.integers(1, 9), st.integers(1, 4), st.integers(1, 5)),
    compression=st.sampled_from([None, "gzip", "lzf"]),
    fletcher32=st.booleans(),
    shuffle=st.booleans(),
)

OPTIONS = st.builds(
    EstimateOptions,
    sigma=st.sampled_from(list(SigmaMode)),
    refine=st.sampled_from(list(Refine)),
    counter=st.sampled_from([counter() for counter in COUNTERS.values()]),
    max_layers=st.integers(1, 7),
    false_alarm=st.sampled_from([1e-5, 1e-3, 0.05]),
    max_iter=st.sampled_from([1, 3, 50]),
    min_samples=st.integers(2, 6),
    unambiguous_range_mm=st.sampled_from([None, None, 6000.0, 8000.0]),
)


@st.composite
def samples(draw: st.DrawFn) -> NDArray[np.float64]:
    """Ranges (frame, row, col) in whole mm from 1 on, NaN where invalid: surfaces, ties, strays and gaps, by a seed."""
    shape = draw(st.integers(1, 24)), draw(st.integers(1, 5)), draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    spread = draw(st.sampled_from([0.0, 3.0, 25.0, 400.0]))
    places = rng.uniform(400, RANGE_MAX_MM, draw(st.integers(1, 4)))
    ranges = rng.choice(places, shape) + spread * rng.standard_normal(shape)
    stray = rng.random(shape) < draw(st.sampled_from([0.0, 0.05, 1.0]))
    ranges[stray] = draw(st.sampled_from([1.0, 7500.0, 9000.0, 3000.0]))
    ranges = np.clip(np.rint(ranges), 1, 60000)
    ranges[rng.random(shape) < draw(st.sampled_from([0.0, 0.2, 0.9, 1.0]))] = np.nan
    return ranges


@contextmanager
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="properties-") as name:
        yield Path(name)


def estimated(
    recording: Path, options: EstimateOptions, *, window: int | None = None, stride: int | None = None, workers: int = 1
) -> tuple[bytes, list[Layers]]:
    """Bytes and windows of the layers file."""
    target = recording.with_name(f"{recording.stem}.layers.h5")
    with open_recording(recording) as source:
        windows = plan_windows(source.shape[0], window=window, stride=stride)
        engine = LocalEngine(source=source, workers=workers, memory_bytes=MEMORY_BYTES, folder=recording.parent)
        run_job(plan_job(source, windows, options, {}), engine, target, overwrite=True)
    with open_layers(target) as layers:
        found = [layers.read_window(index) for index in range(layers.shape[0])]
    return target.read_bytes(), found


def assert_same(one: list[Layers], other: list[Layers]) -> None:
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        for spec in LAYER_FIELDS:
            np.testing.assert_array_equal(getattr(a, spec.name), getattr(b, spec.name), err_msg=spec.name)


@given(samples=samples(), storage=STORAGES, options=OPTIONS, data=st.data())
@examples(30)
def test_every_result_is_one_that_the_contract_allows(
    samples: NDArray[np.float64], storage: Storage, options: EstimateOptions, data: st.DataObject
) -> None:
    window = data.draw(st.none() | st.integers(1, len(samples)))
    stride = data.draw(st.none() | st.integers(1, 8)) if window else None
    with folder() as place:
        _, found = estimated(storage.write(place / "a.h5", samples), options, window=window, stride=stride)
    length, step = window or len(samples), stride or window or len(samples)
    assert len(found) == (len(samples) - length) // step + 1
    for index, layers in enumerate(found):
        taken = np.isfinite(samples[index * step : index * step + length]).sum(axis=0)
        _check(layers, taken, options)


def _check(layers: Layers, taken: NDArray[Any], options: EstimateOptions) -> None:
    n, status = layers.n_modes, layers.status
    present = np.arange(layers.max_layers) < n[..., None]
    np.testing.assert_array_equal(layers.n_samples, taken)
    np.testing.assert_array_equal(status == Status.TOO_FEW_SAMPLES, taken < options.min_samples)
    fitted = status != Status.TOO_FEW_SAMPLES
    assert (n <= options.max_layers).all()
    assert not n[~fitted].any()
    np.testing.assert_array_equal(status == Status.NO_SURFACE, fitted & (n == 0))
    for name in ("range", "sigma", "weight"):
        np.testing.assert_array_equal(np.isfinite(getattr(layers, name)), present, err_msg=name)
    total = np.nansum(layers.weight, axis=-1) + layers.weight_no_return + layers.weight_outlier
    np.testing.assert_allclose(total[fitted], 1, atol=1e-5)
    shares = np.concatenate([layers.weight[present], layers.weight_no_return[fitted], layers.weight_outlier[fitted]])
    assert ((shares >= 0) & (shares <= 1 + 1e-6)).all()
    with np.errstate(invalid="ignore"):
        assert not (np.diff(layers.range, axis=-1) < 0).any()
    assert (layers.sigma[present] > 0).all()
    assert np.isfinite(layers.log_likelihood[fitted]).all()
    assert set(np.unique(status)) <= {int(known) for known in Status}
    assert (layers.n_iter <= options.max_iter * 100).all()
    if options.unambiguous_range_mm is not None:
        ranges = layers.range[present]
        assert ((ranges >= 0) & (ranges <= options.unambiguous_range_mm)).all()


@pytest.mark.slow
@given(samples=samples(), storage=STORAGES, options=OPTIONS, workers=st.integers(2, 4), data=st.data())
@examples(15)
def test_storage_and_workers_change_no_layer(
    samples: NDArray[np.float64], storage: Storage, options: EstimateOptions, workers: int, data: st.DataObject
) -> None:
    """Types, fill values, chunks and filters are ways to say the same; the file's bytes hold for any workers."""
    window = data.draw(st.none() | st.integers(1, len(samples)))
    with folder() as place:
        _, plain = estimated(Storage().write(place / "a.h5", samples), options, window=window)
        path = storage.write(place / "b.h5", samples)
        alone, other = estimated(path, options, window=window)
        together, _ = estimated(path, options, window=window, workers=workers)
    assert_same(plain, other)
    assert together == alone


@pytest.mark.slow
@given(samples=samples(), options=OPTIONS, seed=st.integers(0, 99))
@examples(15)
def test_order_of_frames_changes_no_layer(samples: NDArray[np.float64], options: EstimateOptions, seed: int) -> None:
    with folder() as place:
        _, one = estimated(Storage().write(place / "a.h5", samples), options)
        shuffled = np.random.default_rng(seed).permutation(samples)
        _, other = estimated(Storage().write(place / "b.h5", shuffled), options)
    assert_same(one, other)


@pytest.mark.slow
@given(samples=samples(), options=OPTIONS, data=st.data())
@examples(15)
def test_the_union_of_two_sets_of_pixels_has_the_two_results(
    samples: NDArray[np.float64], options: EstimateOptions, data: st.DataObject
) -> None:
    axis = data.draw(st.sampled_from([1, 2]))
    cut = data.draw(st.integers(0, samples.shape[axis]))
    parts = [part for part in np.split(samples, [cut], axis=axis) if part.size]
    with folder() as place:
        _, (whole,) = estimated(Storage().write(place / "a.h5", samples), options)
        found = [estimated(Storage().write(place / "b.h5", part), options)[1][0] for part in parts]
    for spec in LAYER_FIELDS:
        if spec.name == "probability" and not np.isfinite(samples).all():
            continue  # lost samples are compared with those of the whole image
        both = np.concatenate([getattr(part, spec.name) for part in found], axis=axis - 1)
        np.testing.assert_array_equal(getattr(whole, spec.name), both, err_msg=spec.name)


@pytest.mark.slow
@given(samples=samples(), options=OPTIONS, data=st.data())
@examples(10)
def test_each_window_equals_the_estimate_of_its_frames_alone(
    samples: NDArray[np.float64], options: EstimateOptions, data: st.DataObject
) -> None:
    window, stride = data.draw(st.integers(1, len(samples))), data.draw(st.integers(1, 8))
    with folder() as place:
        _, found = estimated(Storage().write(place / "a.h5", samples), options, window=window, stride=stride)
        index = data.draw(st.integers(0, len(found) - 1))
        part = samples[index * stride : index * stride + window]
        _, alone = estimated(Storage().write(place / "b.h5", part), options)
    assert_same([found[index]], alone)


@pytest.mark.parametrize(("window", "stride"), [(25, None), (0, None)])
def test_windows_that_do_not_fit_are_refused(tmp_path: Path, window: int, stride: int | None) -> None:
    path = Storage().write(tmp_path / "a.h5", np.full((24, 2, 2), 1000.0))
    with pytest.raises((UsageError, ValueError), match="window"):
        estimated(path, EstimateOptions(), window=window, stride=stride)
    assert h5py.is_hdf5(path)
    assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]
