"""Layers in memory: estimated from a recording, or read from a layers file."""

import hashlib
import os
import warnings
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from tofmix.api.recordings import Recording, opened_recording
from tofmix.choices import Mixing, Refine, Shape, Sigma, Widths
from tofmix.errors import BadInputError, DoubtWarning
from tofmix.layers import LAW_TEXTS, Layers, Provenance
from tofmix.mixing import MixingLaw, law_over_windows
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.version import __version__

if TYPE_CHECKING:
    from xarray import Dataset

    from tofmix.estimation.noise_choice import NoiseRequest
    from tofmix.estimation.peaks.counters import Counter
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.recording import SampleSource
    from tofmix.windows import Windows

FILE, AUTO = "file", "auto"


class Choices(TypedDict, total=False):
    """Options of `estimate` that change values: the fields of `tofmix.estimation.settings.EstimateOptions`."""

    sigma: Sigma
    max_layers: int
    counter: "Counter"
    refine: Refine
    false_alarm: float
    max_iter: int
    tol: float
    min_samples: int
    unambiguous_range_mm: float | None
    mixing: Mixing
    paper: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate(Layers):
    """Layers of every pixel and window, with their source and options.

    The arrays are those of a layers file (docs/reference/formats.md): (window, row, col), and (window, row, col, layer)
    for values of each layer, near to far and NaN after `n_modes`.

    Parameters
    ----------
    provenance : Provenance
        Source, camera with the noise curve that was used, and options.
    window_start, window_stop : (window,) uint64
        Frames [start, stop) of each window.
    phasor_share, phasor_pixels : (window,) array or None
        Share of the samples at edges that are phasor sums, and the pixels that determine it; None if not measured.
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
        return law_over_windows(self.phasor_share, self.phasor_pixels)

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
                spec.dims, getattr(self, spec.name),
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
    noise_shape: Shape = "auto",
    noise_widths: Widths = "auto",
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
        Source of sigma(r): the recording, its samples, the built-in camera of this name, or this curve. The default is
        the recording, or its samples if it has no curve.
    outliers : {"file", "auto"} or float
        p(c_r): the recording's, counted in its samples, or this share.
    noise_shape : {"auto", "gaussian"}
        Shape of the error in measured noise: learnt from the samples, or Gaussian.
    noise_widths : {"auto", "common", "own"}
        Width of measured noise: as the samples show, one of all pixels, or one of each pixel.
    window, stride : int, optional
        Frames that make one estimate, and frames from one window to the next; all frames, and the window.
    workers : int, optional
        Threads; all processors without it. It changes no value.
    force : bool
        Whether the means of a recording that is marked as averaged are used as samples. ``mixing="phasor"`` always
        accepts them, because means are phasor sums.
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
        If the file cannot be read, is marked as averaged, or its samples do not determine the noise.

    Warns
    -----
    DoubtWarning
        If the scatter of the samples differs from the noise curve, if ranges drift within a window, if a default or a
        simplification replaces a part of the noise, and for the findings of `tofmix report`.
    """
    from tofmix.estimation.blocks.sample_span import sensor_with_span
    from tofmix.estimation.blocks.sequence import estimate_windows, resolved_mixing
    from tofmix.estimation.noise.no_return import no_return_constant
    from tofmix.estimation.noise_choice import NoiseRequest, check_parts, noise_options
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.recording import amplitude_source
    from tofmix.windows import plan_windows

    source = recording if isinstance(recording, Recording) else opened_recording(Path(recording))
    options = EstimateOptions(**choices)  # type: ignore[arg-type]  # texts become members of their enumerations there
    if source.averaged and not force and options.mixing != "phasor":
        raise BadInputError(
            f"{source.name}: marked as averaged: a mean does not separate surfaces;"
            " mixing='phasor' unmixes them, force=True uses the means as samples"
        )
    windows = plan_windows(source.shape[0], window=window, stride=stride)
    other = None if noise in (None, AUTO) else noise if isinstance(noise, str) else "NoiseCurve"
    check_parts(options, shape=noise_shape, widths=noise_widths, other_noise=other, spell=_spell)
    if isinstance(outliers, str) and outliers not in (FILE, AUTO):
        raise ValueError(f"outliers: {outliers!r} is not file, auto or a number")
    asked = noise if noise is not None else AUTO if source.sensor.noise is None else FILE
    with source.opened() as samples:
        source = source.with_sensor(sensor_with_span(samples, options.unambiguous_range_mm))
    wanted = NoiseRequest(
        noise=_named(source, asked), outliers=outliers, asked=noise is not None, window_frames=windows.length,
        stride_frames=windows.stride, shape=noise_shape, widths=noise_widths, workers=workers or os.cpu_count() or 1,
    )  # fmt: skip
    sensor, from_samples = _chosen(source, options, wanted)
    asked = AUTO if from_samples else asked
    source = source.with_sensor(sensor)
    of_samples = windows.of_samples(max(1, source.targets))
    with source.opened() as samples:
        if options.unambiguous_range_mm is None and not options.paper and sensor.no_return_mm is None:
            sensor = replace(sensor, no_return_mm=no_return_constant(samples))
        _say_doubts(samples, sensor, asked, windows.length, options.unambiguous_range_mm)
    source = source.with_sensor(sensor)
    unmix = options.mixing == "auto"
    with source.opened() as samples:
        has_amplitude = amplitude_source(samples) is not None
        options = resolved_mixing(options, samples)
        found = estimate_windows(samples, options, windows=of_samples, workers=workers or os.cpu_count() or 1)
    name = asked if isinstance(asked, str) else "given"
    said = noise_options(name, outliers, shape=noise_shape, widths=noise_widths)
    provenance = Provenance(
        source=source.name, source_sha256=_checksum(source), version=__version__, sensor=sensor,
        options=options.as_dict() | said | {"window": windows.length, "stride": windows.stride},
        frames_left_out=windows.frames_left_out, targets=source.targets, has_amplitude=has_amplitude,
    )  # fmt: skip
    starts = np.arange(windows.count, dtype=np.uint64) * np.uint64(windows.stride)
    made = Estimate(
        **_arrays(found.layers), provenance=provenance, window_start=starts,
        window_stop=starts + np.uint64(windows.length), phasor_share=found.phasor_share,
        phasor_pixels=found.phasor_pixels, recording=source,
    )  # fmt: skip
    _say_findings(made, unmix=unmix, has_amplitude=has_amplitude)
    return made


def read_estimate(path: Path) -> Estimate:
    """Read a layers file into memory.

    Raises
    ------
    BadInputError
        If it is missing, damaged or not a layers file.
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


def _spell(name: str, value: str) -> str:
    """An option with its value, as in Python; a switch has no value."""
    return f"{name}={value!r}" if value else f"{name}=True"


def _named(source: Recording, noise: str | NoiseCurve) -> str | NoiseCurve:
    """The noise, with the curve of a built-in camera in place of its name."""
    from tofmix.sensors import noise_of_profile

    if isinstance(noise, NoiseCurve) or noise in (FILE, AUTO):
        return noise
    curve, doubt = noise_of_profile(noise, source.sensor.integration_time_ms)
    if doubt is not None:
        warnings.warn(f"{source.name}: {doubt}", DoubtWarning, stacklevel=3)
    return curve


def _chosen(source: Recording, options: "EstimateOptions", request: "NoiseRequest") -> tuple[Sensor, bool]:
    """The camera of the estimate, and whether its curve is from the samples; its doubts become warnings."""
    from tofmix.estimation.noise_choice import choose_sensor

    with source.opened() as samples:

        def use(sensor: Sensor) -> "SampleSource":
            if isinstance(samples, ArrayRecording):
                return samples.with_sensor(sensor)
            samples.sensor = sensor  # type: ignore[misc]  # a file that is open has a camera to set
            return samples

        choice = choose_sensor(source.name, use, source.sensor, options, request, spell=_spell)
    for note in choice.notes:
        if note.is_warning:
            warnings.warn(note.text, DoubtWarning, stacklevel=3)
    return choice.sensor, choice.from_samples


def _say_doubts(
    samples: "SampleSource", sensor: Sensor, noise: str | NoiseCurve, window_frames: int, circle_mm: float | None
) -> None:
    """Warn of the doubts about the samples that `tofmix estimate` prints before it estimates them."""
    from tofmix.estimation.noise.consistency import check_consistency
    from tofmix.independent_samples import independent_samples
    from tofmix.report.summary.findings import Remedy, sample_findings

    seen = check_consistency(
        independent_samples(samples, for_noise=True), sensor.noise, step=sensor.step, window_frames=window_frames,
        unambiguous_range_mm=circle_mm, follows_drift=sensor.follows_drift,
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
    "flying_pixels_counted": "from_array takes amplitude=..., with_sensor modulation_frequency_hz=...",
}
"""Remedies of findings, as parameters of `estimate`."""


def _say_findings(layers: Estimate, *, unmix: bool, has_amplitude: bool) -> None:
    """Warn of the findings that `tofmix estimate` prints about its layers; its notes are no warnings."""
    from tofmix.report.summary.findings import split_notes
    from tofmix.report.summary.lost import cause_of_loss
    from tofmix.report.summary.summary import find, remedy_for

    remedy = replace(remedy_for(layers.provenance, layers.shape[0]), unmix=unmix, has_amplitude=has_amplitude)
    assert layers.recording is not None  # noqa: S101  it was just estimated
    with layers.recording.opened() as samples:
        warned, _ = split_notes(find(layers, remedy, cause=partial(cause_of_loss, samples)))
    for finding in warned:
        text = f"{finding.text} {_IN_PYTHON.get(finding.code, '')}".strip()
        warnings.warn(text, DoubtWarning, stacklevel=3)


def _checksum(source: Recording) -> str:
    """SHA-256 of the file, or of the samples."""
    if source.path is not None:
        from tofmix.io.recording.recording_file import file_sha256

        return file_sha256(source.path)
    return hashlib.sha256(np.ascontiguousarray(source.range_mm).tobytes()).hexdigest()
