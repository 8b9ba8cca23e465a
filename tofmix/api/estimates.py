"""Layers as Python holds them: estimated from a recording, or read from a layers file."""

import hashlib
import os
import warnings
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from tofmix.api.recordings import Recording, opened_recording
from tofmix.errors import BadInputError, DoubtWarning
from tofmix.layers import LAW_TEXTS, Layers, Provenance
from tofmix.mixing import MixingLaw
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.version import __version__

if TYPE_CHECKING:
    from xarray import Dataset

    from tofmix.estimation.noise.measurement import MeasuredNoise
    from tofmix.estimation.peaks.counters import Counter
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.recording import SampleSource
    from tofmix.windows import Windows

FILE, AUTO = "file", "auto"
_DIMS = ("window", "row", "col", "layer")


class Choices(TypedDict, total=False):
    """Options of `estimate` that change values: the fields of `tofmix.estimation.settings.EstimateOptions`."""

    sigma: str
    max_layers: int
    counter: "Counter"
    refine: str
    false_alarm: float
    max_iter: int
    tol: float
    min_samples: int
    unambiguous_range_mm: float | None
    mixing: str
    paper: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate(Layers):
    """Layers of every pixel and window, with what they were made from.

    The arrays are those of a layers file (docs/reference/formats.md): (window, row, col), and (window, row, col, layer)
    where each layer has a value of its own, near to far and NaN past `n_modes`.

    Parameters
    ----------
    provenance : Provenance
        Source, camera with the noise curve that was used, and options.
    window_start, window_stop : (window,) uint64
        Frames [start, stop) of each window.
    phasor_share, phasor_pixels : (window,) array or None
        Share of the samples at edges that are phasor sums, and pixels that tell it; None where it was not measured.
    recording : Recording or None
        The samples; None for layers read from a file.
    """

    provenance: Provenance
    window_start: NDArray[np.uint64]
    window_stop: NDArray[np.uint64]
    phasor_share: NDArray[np.floating] | None = None
    phasor_pixels: NDArray[np.integer] | None = None
    recording: Recording | None = None

    def __repr__(self) -> str:
        windows, rows, cols = self.shape
        several = float((self.n_modes > 1).mean())
        return (
            f"<Estimate of {self.provenance.source}: {windows} x {rows} x {cols} pixels (window, row, col),"
            f" {100 * several:.1f} % with several surfaces>"
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Windows, rows, columns."""
        windows, rows, cols = self.n_modes.shape
        return windows, rows, cols

    @property
    def sensor(self) -> Sensor:
        """The camera, with the noise curve that was used."""
        return self.provenance.sensor

    @property
    def options(self) -> dict[str, str | int | float]:
        """Every option that affects values, by name."""
        return self.provenance.options

    @property
    def mixing_law(self) -> MixingLaw | None:
        """The law of mixing over all windows; None where it was not measured."""
        if self.phasor_share is None or self.phasor_pixels is None:
            return None
        return MixingLaw.of_windows(self.phasor_share, self.phasor_pixels)

    def window(self, number: int) -> Layers:
        """Layers of one window, of the leading shape (row, col); arrays are not copied."""
        return Layers(**{spec.name: getattr(self, spec.name)[number] for spec in self.fields})

    def read_window(self, window: int) -> Layers:
        """The same as `window`, by the name that a layers file has for it."""
        return self.window(window)

    def to_xarray(self) -> "Dataset":
        """The same as an xarray dataset with named dimensions, units and descriptions.

        Returns
        -------
        xarray.Dataset
            Equal to what xarray reads from the layers file that `save` writes.

        Raises
        ------
        ModuleNotFoundError
            If xarray is missing: pip install 'tofmix[notebook]'.
        """
        try:
            import xarray
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError("to_xarray needs xarray: pip install 'tofmix[notebook]'") from error
        variables: dict[str, Any] = {
            spec.name: (
                _DIMS if spec.per_layer else _DIMS[:3], getattr(self, spec.name),
                {"units": spec.units, "long_name": spec.long_name},
            )
            for spec in self.fields
        }  # fmt: skip
        for name, text in (("start", "first frame of the window"), ("stop", "one past the last frame of the window")):
            attributes = {"units": "1", "long_name": text}
            variables[f"window_{name}"] = ("window", getattr(self, f"window_{name}"), attributes)
        if self.phasor_share is not None:
            for name, text in LAW_TEXTS.items():
                variables[name] = ("window", getattr(self, name), {"units": "1", "long_name": text})
        made = self.provenance
        about = {"source": made.source, "tofmix_version": made.version, "sensor": made.sensor.name}
        return xarray.Dataset(variables, attrs=about | {"options": str(made.options)})

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write a layers file, which every command of tofmix reads.

        Parameters
        ----------
        path : str or Path
            The new file, by custom ``*.layers.h5``.
        overwrite : bool
            Whether it may be replaced.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        UsageError
            If the file exists and must not be replaced.
        StorageError
            If it cannot be written.
        """
        from tofmix.grid import plan_grid
        from tofmix.io.layers.chunks import encode_cell
        from tofmix.io.layers.layers_file import LayersWriter

        target, windows = Path(path), self._windows()
        image = int(self.shape[1]), int(self.shape[2])
        grid = plan_grid(windows, image)
        source = None if self.recording is None else self.recording.path
        writer = LayersWriter(
            target, windows=windows, image=image, max_layers=self.max_layers, tile=grid.step,
            provenance=self.provenance, overwrite=overwrite, inputs=() if source is None else (source,),
        )  # fmt: skip
        with writer:
            if self.phasor_share is not None and self.phasor_pixels is not None:
                for number, (share, pixels) in enumerate(zip(self.phasor_share, self.phasor_pixels, strict=True)):
                    writer.write_law(number, float(share), int(pixels))
            for cell in grid.cells():
                place = cell.windows, cell.rows
                part = Layers(**{spec.name: getattr(self, spec.name)[place] for spec in self.fields})
                writer.write_chunks(cell.windows, cell.rows, encode_cell(part, shape=(*grid.step, image[1])).chunks)
        return target

    def _windows(self) -> "Windows":
        from tofmix.windows import Windows

        length = int(self.window_stop[0] - self.window_start[0])
        stride = int(self.window_start[1]) if len(self.window_start) > 1 else int(self.options.get("stride", length))
        return Windows(length, stride, len(self.window_start), self.provenance.frames_left_out)


def estimate(
    recording: Recording | str | os.PathLike[str],
    *,
    noise: str | NoiseCurve | None = None,
    outliers: str | float = FILE,
    window: int | None = None,
    stride: int | None = None,
    workers: int | None = None,
    force: bool = False,
    **choices: Unpack[Choices],
) -> Estimate:
    """Recover the surfaces in each pixel of a recording, in memory.

    Parameters
    ----------
    recording : Recording or path
        The samples; a path is opened.
    noise : {"file", "auto"}, str or NoiseCurve, optional
        Where sigma(r) comes from: the recording, its samples, the built-in camera of this name, or this curve. By
        default the recording's, and where it has none, its samples.
    outliers : {"file", "auto"} or float
        p(c_r): the recording's, counted in its samples, or this share.
    window, stride : int, optional
        Frames that make one estimate, and frames from one window to the next; all frames, and the window.
    workers : int, optional
        Threads; all processors without it. It changes no value.
    force : bool
        Whether a recording that is marked as averaged is taken all the same; with ``mixing="phasor"`` it is anyway, as
        means are phasor sums.
    **choices
        Fields of `tofmix.estimation.settings.EstimateOptions`, for example ``sigma="tied"`` or ``paper=True``.

    Returns
    -------
    Estimate
        The same values as `tofmix estimate` writes.

    Raises
    ------
    ValueError
        If an option is out of its bounds.
    BadInputError
        If the file cannot be read, is marked as averaged, or its samples do not tell the noise.

    Warns
    -----
    DoubtWarning
        If the samples scatter otherwise than the noise curve says, or drift within a window; and where the layers are
        doubtful, as `tofmix report` says it.
    """
    from tofmix.estimation.blocks.sample_span import sensor_with_span
    from tofmix.estimation.blocks.sequence import estimate_windows, settled_mixing
    from tofmix.estimation.noise.no_return import no_return_constant
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.windows import plan_windows

    source = recording if isinstance(recording, Recording) else opened_recording(Path(recording))
    options = EstimateOptions(**choices)  # type: ignore[arg-type]  # texts become members of their enumerations there
    if source.averaged and not force and options.mixing != "phasor":
        raise BadInputError(
            f"{source.name}: marked as averaged: a mean does not separate surfaces;"
            " mixing='phasor' unmixes them, force=True uses the means as samples"
        )
    windows = plan_windows(source.shape[0], window=window, stride=stride)
    asked = noise if noise is not None else AUTO if source.sensor.noise is None else FILE
    with source.opened() as samples:
        source = source.with_sensor(sensor_with_span(samples, options.unambiguous_range_mm))
    sensor = _sensor(source, asked, outliers, options, windows, workers or os.cpu_count() or 1)
    source = source.with_sensor(sensor)
    if noise is None and asked == FILE:
        with source.opened() as samples:
            sensor = _questioned(samples, options, windows, workers or os.cpu_count() or 1)
        asked = asked if sensor is source.sensor else AUTO
        source = source.with_sensor(sensor)
    of_samples = windows.of_samples(max(1, source.targets))
    with source.opened() as samples:
        if options.unambiguous_range_mm is None and not options.paper and sensor.no_return_mm is None:
            sensor = replace(sensor, no_return_mm=no_return_constant(samples))
        _say_doubts(samples, sensor, asked, windows.length, options.unambiguous_range_mm)
    source = source.with_sensor(sensor)
    with source.opened() as samples:
        options = settled_mixing(options, samples)
        found = estimate_windows(samples, options, windows=of_samples, workers=workers or os.cpu_count() or 1)
    said = {"noise": asked if isinstance(asked, str) else "given", "outliers": outliers}
    provenance = Provenance(
        source=source.name, source_sha256=_checksum(source), version=__version__, sensor=sensor,
        options=options.as_dict() | said | {"window": windows.length, "stride": windows.stride},
        frames_left_out=windows.frames_left_out, targets=source.targets,
    )  # fmt: skip
    starts = np.arange(windows.count, dtype=np.uint64) * np.uint64(windows.stride)
    made = Estimate(
        **_arrays(found.layers), provenance=provenance, window_start=starts,
        window_stop=starts + np.uint64(windows.length), phasor_share=found.phasor_share,
        phasor_pixels=found.phasor_pixels, recording=source,
    )  # fmt: skip
    _say_findings(made)
    return made


def read_estimate(path: Path) -> Estimate:
    """Read a layers file into memory.

    Raises
    ------
    BadInputError
        If it is missing, damaged or no layers file.
    """
    from tofmix.io.layers.layers_file import open_layers

    with open_layers(path) as file:
        layers = file.read_block(slice(None), slice(None))
        return Estimate(
            **_arrays(layers), provenance=file.provenance, window_start=file.window_start, window_stop=file.window_stop,
            phasor_share=file.phasor_share, phasor_pixels=file.phasor_pixels,
        )  # fmt: skip


def _arrays(layers: Layers) -> dict[str, Any]:
    return {field.name: getattr(layers, field.name) for field in fields(Layers)}


def _knows_gaussian_alone(options: "EstimateOptions") -> bool:
    """Whether the options leave no room for learnt noise."""
    return bool(options.paper or options.refine == "none" or options.sigma == "free")


def _questioned(samples: "SampleSource", options: "EstimateOptions", windows: "Windows", workers: int) -> Sensor:
    """The camera with the file's noise, or the learnt one where the samples contradict the file's."""
    from tofmix.estimation.learnt.recordings import calibrated, has_parts, learn_if_contradicted
    from tofmix.estimation.unrolling import UnrolledSource

    sensor, length = samples.sensor, options.unambiguous_range_mm
    if sensor.noise is None or _knows_gaussian_alone(options):
        return sensor
    ranges = samples if length is None else UnrolledSource(samples, length)
    if has_parts(sensor.noise):
        return calibrated(ranges, window_frames=windows.length, min_samples=options.min_samples, workers=workers)
    found = learn_if_contradicted(
        ranges, window_frames=windows.length, stride_frames=windows.stride, drift=length is None,
        min_samples=options.min_samples, workers=workers,
    )  # fmt: skip
    return sensor if found is None else found.sensor


def _learnt(source: Recording, options: "EstimateOptions", windows: "Windows", workers: int) -> Sensor:
    from tofmix.estimation.learnt.recordings import learn_noise
    from tofmix.estimation.unrolling import UnrolledSource

    length = options.unambiguous_range_mm
    with source.opened() as samples:
        try:
            return learn_noise(
                samples if length is None else UnrolledSource(samples, length), window_frames=windows.length,
                stride_frames=windows.stride, drift=length is None, min_samples=options.min_samples, workers=workers,
            ).sensor  # fmt: skip
        except ValueError as error:
            raise BadInputError(f"{source.name}: {error}") from error


def _sensor(
    source: Recording,
    noise: str | NoiseCurve,
    outliers: str | float,
    options: "EstimateOptions",
    windows: "Windows",
    workers: int,
) -> Sensor:
    """The recording's camera with the noise and the p(c_r) that were asked for."""
    sensor = source.sensor
    if noise == AUTO and not _knows_gaussian_alone(options):
        sensor = _learnt(source, options, windows, workers)
    elif noise == AUTO:
        sensor = replace(sensor, noise=_measured(source, options.unambiguous_range_mm).curve)
    if outliers == AUTO:
        measured = _measured(source, options.unambiguous_range_mm)
        sensor = replace(sensor, outlier_probability=measured.outlier_probability)
    if not isinstance(outliers, str):
        sensor = replace(sensor, outlier_probability=float(outliers))
    elif outliers not in (FILE, AUTO):
        raise ValueError(f"outliers: {outliers!r} is not file, auto or a number")
    if isinstance(noise, NoiseCurve):
        sensor = replace(sensor, noise=noise)
    elif noise not in (FILE, AUTO):
        from tofmix.sensors import load_profile

        profile = load_profile(noise)
        tau_ms = sensor.integration_time_ms or profile.integration_time_ms
        sensor = replace(sensor, noise=profile.noise_at(tau_ms))
    if sensor.noise is None:
        raise BadInputError(f"{source.name}: no noise curve; leave out noise='file' to measure one")
    if options.unambiguous_range_mm is not None and sensor.noise.law is not None:
        sensor = replace(sensor, noise=replace(sensor.noise, law=None))  # on a circle sigma goes by range alone
    return sensor


def _say_doubts(
    samples: "SampleSource", sensor: Sensor, noise: str | NoiseCurve, window_frames: int, circle_mm: float | None
) -> None:
    """Warn of what `tofmix estimate` says of the samples before it estimates them."""
    from tofmix.estimation.learnt.model import follows_drift
    from tofmix.estimation.noise.consistency import check_consistency
    from tofmix.report.summary.findings import Remedy, sample_findings

    seen = check_consistency(
        samples, sensor.noise, window_frames=window_frames, unambiguous_range_mm=circle_mm,
        follows_drift=follows_drift(sensor),
    )  # fmt: skip
    scatter = None if noise == AUTO else seen.scatter_over_curve  # a curve that the samples gave is theirs
    remedy = Remedy(recording="recording", window_frames=window_frames)
    for finding in sample_findings(scatter_over_curve=scatter, drift_sigmas=seen.drift_sigmas, remedy=remedy):
        warnings.warn(f"{finding.text} {_IN_PYTHON[finding.code]}", DoubtWarning, stacklevel=3)


_IN_PYTHON = {
    "scatter_off_curve": "noise='auto' measures it.",
    "sigma_off_curve": "noise='auto' measures it.",
    "drift": "Take a shorter window.",
    "close_layers": "Take a shorter window, or noise='auto'.",
    "all_layers_used": "A larger max_layers shows them.",
    "not_converged": "Take a larger max_iter.",
    "too_few_samples": "Take a longer window.",
}
"""Remedies of findings, as parameters of `estimate`."""


def _say_findings(layers: Estimate) -> None:
    """Warn of what `tofmix estimate` says of the layers that it made."""
    from tofmix.report.summary.summary import find

    for finding in find(layers):
        text = f"{finding.text} {_IN_PYTHON.get(finding.code, '')}".strip()
        warnings.warn(text, DoubtWarning, stacklevel=3)


def _measured(source: Recording, length: float | None) -> "MeasuredNoise":
    from tofmix.estimation.noise.measurement import measure_noise
    from tofmix.estimation.unrolling import UnrolledSource
    from tofmix.recording import by_target

    with source.opened() as samples:
        try:
            return measure_noise(samples if length is None else UnrolledSource(by_target(samples), length))
        except ValueError as error:
            raise BadInputError(f"{source.name}: {error}") from error


def _checksum(source: Recording) -> str:
    """SHA-256 of the file, or of the samples."""
    if source.path is not None:
        from tofmix.io.recording.recording_file import file_sha256

        return file_sha256(source.path)
    return hashlib.sha256(np.ascontiguousarray(source.range_mm).tobytes()).hexdigest()
