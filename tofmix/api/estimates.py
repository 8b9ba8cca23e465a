"""Layers in memory: estimated from a recording, or read from a layers file.

One function that opens recordings and layers files.
"""

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from tofmix.api.recordings import Recording, opened_recording
from tofmix.flags import MixingLaw, law_over_windows
from tofmix.layers import LAW_TEXTS, Layers, Provenance
from tofmix.options import Mixing, Refine, Shape, Sigma, Widths
from tofmix.sensor import NoiseCurve, Sensor

if TYPE_CHECKING:
    from xarray import Dataset

    from tofmix.estimation.peaks.counters import Counter
    from tofmix.grid import Windows


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
                spec.dims,
                getattr(self, spec.name),
                {"units": spec.units, "long_name": spec.long_name},
            )
            for spec in self.fields
        }
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
            target,
            windows=windows,
            image=image,
            max_layers=self.max_layers,
            tile=grid.step,
            provenance=self.provenance,
            overwrite=overwrite,
            inputs=() if source is None else (source,),
        )
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
        from tofmix.grid import Windows

        length = int(self.window_stop[0] - self.window_start[0])
        stride = int(self.window_start[1]) if len(self.window_start) > 1 else int(self.options.get("stride", length))
        return Windows(length, stride, len(self.window_start), self.provenance.frames_left_out)


def estimate(
    recording: Recording | str | os.PathLike[str],
    *,
    noise: str | NoiseCurve | None = None,
    outliers: str | float = "file",
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
    from tofmix.api.recordings import PythonReporter
    from tofmix.estimation.blocks.sequence import estimate_windows
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.jobs.estimate import EstimateRequest, check_request, prepare, say_findings

    source = recording if isinstance(recording, Recording) else opened_recording(Path(recording))
    options, reporter = EstimateOptions(**choices), PythonReporter()  # type: ignore[arg-type]  # texts become members of their enumerations there
    request = EstimateRequest(
        options=options,
        noise=noise,
        outliers=outliers,
        noise_shape=noise_shape,
        noise_widths=noise_widths,
        window=window,
        stride=stride,
        force=force,
        workers=workers or os.cpu_count() or 1,
    )
    check_request(request, reporter)
    with source.opened() as samples:
        ready = prepare(samples, request, reporter)
        windows, provenance = ready.windows, ready.job.provenance
        found = estimate_windows(
            ready.source,
            ready.job.options,
            windows=windows.of_samples(provenance.samples_a_frame),
            workers=request.workers,
        )
        starts = np.arange(windows.count, dtype=np.uint64) * np.uint64(windows.stride)
        made = Estimate(
            **_arrays(found.layers),
            provenance=provenance,
            window_start=starts,
            window_stop=starts + np.uint64(windows.length),
            phasor_share=found.phasor_share,
            phasor_pixels=found.phasor_pixels,
            recording=source.with_sensor(ready.source.sensor),
        )
        say_findings(made, source.name, ready, reporter)
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
            **_arrays(layers),
            provenance=file.provenance,
            window_start=file.window_start,
            window_stop=file.window_stop,
            phasor_share=file.phasor_share,
            phasor_pixels=file.phasor_pixels,
        )


def _arrays(layers: Layers) -> dict[str, Any]:
    return {field.name: getattr(layers, field.name) for field in fields(Layers)}


def open_file(path: str | Path) -> Recording | Estimate:
    """Open a recording, or the layers that `tofmix estimate` or `Estimate.save` wrote.

    Parameters
    ----------
    path : str or Path
        An HDF5 file.

    Returns
    -------
    Recording or Estimate
        Samples of a recording are read on access; layers are read at once.

    Raises
    ------
    BadInputError
        If the file is missing, damaged or neither of the two, or its ranges are probably not in mm.

    Warns
    -----
    DoubtWarning
        If many of a recording's samples are exactly 0 and count as ranges.
    """
    from tofmix.io.hdf5 import format_of
    from tofmix.io.layers.layers_file import FORMAT

    file = Path(path)
    return read_estimate(file) if format_of(file) == FORMAT else opened_recording(file)
