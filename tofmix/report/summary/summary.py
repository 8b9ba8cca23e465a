"""The numbers of a layers file: counts, errors and warnings.

`summarise` reads window by window, so a sequence of any length fits in memory.
For one pixel or one window read the file itself.

`noise_numbers` gives the learnt noise of a file in numbers and in a line.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import ByteArray, Float32Array, FloatArray
from tofmix.circle import circular_noise
from tofmix.estimation.learnt.model import noise_words, shape_words
from tofmix.flags import Mixing, Status, mixing_name, status_name
from tofmix.layers import Layers, LayersSource, Provenance
from tofmix.report.summary.findings import (
    DEFAULT_THRESHOLDS,
    Finding,
    Remedy,
    Thresholds,
    count_findings,
    filter_findings,
    frame_findings,
    light_findings,
    sigma_findings,
    spatial_findings,
    split_notes,
    suspect_findings,
    target_findings,
)
from tofmix.report.summary.lost import Cause, LostNumbers, LostTally
from tofmix.report.summary.moved_frames import Frames, MovedFrames, find_moved, moved_findings
from tofmix.report.summary.quantiles import Quantiles, ValueCounts, spread_of
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.suspicion import SUSPICIONS, count_suspects
from tofmix.unmixing.settings import DEFAULT_SETTINGS
from tofmix.wording import finite_or_none


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseNumbers:
    """Learnt noise, or noise with parts beyond a curve. None means that the part is missing."""

    line: str  # all parts in words, as in the line of `tofmix estimate`
    # Least and largest sigma of the curve.
    sigma_least_mm: float
    sigma_most_mm: float
    shape: str  # ``Gaussian``, ``skewed (1.3)``, ``long-tailed`` or ``short-tailed``
    # Of the shape.
    skewness: float | None = None
    excess_kurtosis: float | None = None
    width_spread: float | None = None  # standard deviation of log width over the pixels
    widths: Quantiles | None = None  # the pixels' own widths, of those with a surface
    background: Quantiles | None = None  # share of background over the pixels
    # Ranges, mm, between which 90 % of the background lies, where it is not uniform over the working range.
    background_range_mm: tuple[float, float] | None = None
    # Scale of each polynomial of time that a pixel's ranges may follow within a window.
    drift_mm: list[float] | None = None
    memory: float | None = None  # correlation of the error from one frame to the next
    # Half the width of the central 68 % of a pixel's samples over sigma(r), over pixels of one layer; with the
    # recording alone.
    scatter_over_sigma: Quantiles | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the same as a dict, for JSON."""
        return asdict(self)


def has_more_than_a_curve(sensor: Sensor) -> bool:
    """Whether a sensor's noise has learnt parts, or parts of a file, beyond sigma by range and amplitude."""
    curve = sensor.noise
    if curve is None:
        return False
    return curve.has_parts or sensor.learnt is not None


def noise_numbers(sensor: Sensor, widths: ValueCounts | None = None) -> NoiseNumbers | None:
    """The numbers of a sensor's noise, with the pixels' own widths.

    None where it is a Gaussian of a curve, or there is no curve.
    """
    curve, learnt = sensor.noise, sensor.learnt
    if curve is None or not has_more_than_a_curve(sensor):
        return None
    skewness, kurtosis = (None, None) if curve.shape is None else (float(m) for m in curve.shape.moments()[2:])
    ends = None
    if curve.background_density is not None:
        near, far = (float(q) for q in curve.background_density.quantile((0.05, 0.95)))
        ends = near, far
    return NoiseNumbers(
        line=", ".join(noise_words(sensor)),
        sigma_least_mm=float(curve.sigma_mm.min()),
        sigma_most_mm=float(curve.sigma_mm.max()),
        shape=shape_words(curve),
        skewness=skewness,
        excess_kurtosis=kurtosis,
        width_spread=curve.width_spread or None,
        widths=spread_of(widths) if widths is not None and widths.count else None,
        background=None if curve.background is None else spread_of(curve.background),
        background_range_mm=ends,
        drift_mm=learnt.drift_mm.tolist() if learnt is not None and learnt.drift_mm.any() else None,
        memory=float(learnt.memory) if learnt is not None and learnt.memory else None,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerSummary:
    """One layer over all pixels and windows. None means no such value.

    Medians are over the layer's `count` components; `sigma_over_curve_median` is sigma divided by the sensor's
    sigma(r) at the component's range.
    """

    layer: int
    count: int
    range_mm: Quantiles
    weight_median: float | None
    range_stderr_median_mm: float | None
    sigma_median_mm: float | None
    sigma_over_curve_median: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class MixingNumbers:
    """The law of mixing."""

    line: str  # the law in words
    phasor_share: float | None  # share of the samples at edges that are phasor sums; None if no pixel determines it
    telling_pixels: int  # pixels that determine it
    pixels: dict[str, int]  # pixels by the names of `tofmix.flags.Mixing`


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """A layers file in numbers. Pixels are counted once a window."""

    # From the file's provenance.
    source: str
    source_sha256: str
    version: str
    options: dict[str, str | int | float | None]
    # Its sizes; `window_frames` is the length of the first window.
    windows: int
    window_frames: int
    rows: int
    cols: int
    max_layers: int
    frames_left_out: int
    pixels: int  # windows * rows * cols
    # Entry n counts pixels with n surfaces; with n peaks of the density in step 1.
    pixels_by_surfaces: tuple[int, ...]
    pixels_by_peaks: tuple[int, ...]
    # Pixels of `pixels_by_surfaces` with undecided mixing: their layers are not reliable.
    undecided_by_surfaces: tuple[int, ...]
    # By the names of `tofmix.flags.Status`; a value without a name is ``status_<value>``.
    pixels_by_status: dict[str, int]
    # Suspect layers by the names of `tofmix.suspicion`; a layer may have several.
    layers_by_suspicion: dict[str, int]
    pixels_with_close_layers: int  # pixels with two layers within 5 sigma (of the wider one) of each other
    # Shares of `pixels` with more than one surface, and with none.
    share_several_surfaces: float
    share_no_surface: float
    layers: tuple[LayerSummary, ...]  # one entry for each of `max_layers`, near to far
    weight_no_return: Quantiles  # p(c_0) over the pixels where it is known
    sigma_over_curve: Quantiles  # sigma / sigma(r) over components with a share above 0.5
    samples: Quantiles  # valid samples a pixel
    # Lost samples; None where none was lost, and for layers of versions that did not count them.
    lost: LostNumbers | None
    # The noise, where it has learnt parts, or parts of a file, beyond sigma by range and amplitude.
    noise: NoiseNumbers | None
    mixing: MixingNumbers | None  # the measured mixing
    warnings: tuple[Finding, ...]  # warnings
    notes: tuple[Finding, ...] = ()  # what a recording of its kind cannot show

    @property
    def decided_by_surfaces(self) -> tuple[int, ...]:
        """`pixels_by_surfaces` without the undecided ones."""
        pairs = zip_longest(self.pixels_by_surfaces, self.undecided_by_surfaces, fillvalue=0)
        return tuple(count - undecided for count, undecided in pairs)

    def as_dict(self) -> dict[str, Any]:
        """Return the same as dicts and lists under the same names, for JSON; never NaN, None instead."""
        values = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}
        return values | {key: [finding.as_dict() for finding in getattr(self, key)] for key in ("warnings", "notes")}

    def with_findings(self, findings: Iterable[Finding]) -> Self:
        """The same numbers with other warnings and notes."""
        warnings, notes = split_notes(findings)
        return replace(self, warnings=warnings, notes=notes)


def summarise(
    layers_file: LayersSource,
    remedy: Remedy | None = None,
    *,
    cause: Cause | None = None,
    frames: Frames | None = None,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
) -> Summary:
    """Summarise a layers file over all windows, reading one at a time; the parameters are those of `find`.

    Quantiles are exact up to 65,536 different values and bounded in memory past
    that (see `ValueCounts`); all counts are exact.
    """
    provenance = layers_file.provenance
    tally = _Tally(layers_file, thresholds)
    tally.add_all()
    windows, rows, cols = layers_file.shape
    pixels = windows * rows * cols
    warnings, notes = split_notes(tally.findings(remedy, cause, frames))
    return Summary(
        source=provenance.source,
        source_sha256=provenance.source_sha256,
        version=provenance.version,
        options={name: finite_or_none(value) for name, value in sorted(provenance.options.items())},
        windows=windows,
        window_frames=int(layers_file.window_stop[0] - layers_file.window_start[0]) if windows else 0,
        rows=rows,
        cols=cols,
        max_layers=layers_file.max_layers,
        frames_left_out=provenance.frames_left_out,
        pixels=pixels,
        pixels_by_surfaces=tuple(tally.surfaces),
        pixels_by_peaks=tuple(tally.peaks),
        undecided_by_surfaces=tuple(tally.undecided),
        pixels_by_status=tally.by_status(),
        layers_by_suspicion=tally.suspicions,
        pixels_with_close_layers=tally.close,
        share_several_surfaces=sum(tally.surfaces[2:]) / max(1, pixels),
        share_no_surface=sum(tally.surfaces[:1]) / max(1, pixels),
        layers=tally.layer_summaries(),
        weight_no_return=spread_of(tally.no_return),
        sigma_over_curve=spread_of(tally.dominant_ratio),
        samples=spread_of(tally.samples),
        lost=tally.lost.numbers(),
        noise=noise_numbers(provenance.sensor, tally.widths),
        mixing=_mixing(layers_file, tally),
        warnings=warnings,
        notes=notes,
    )


def _mixing(layers_file: LayersSource, tally: "_Tally") -> MixingNumbers | None:
    """Numbers of the law of mixing; None where it was not measured."""
    law = layers_file.mixing_law
    if law is None:
        return None
    counts = dict(zip((mixing_name(kind) for kind in Mixing), (*tally.mixing, 0, 0, 0, 0), strict=False))
    share = law.as_dict()["phasor_share"]
    return MixingNumbers(line=law.words(), phasor_share=share, telling_pixels=law.pixels, pixels=counts)


def find(
    layers_file: LayersSource,
    remedy: Remedy | None = None,
    *,
    cause: Cause | None = None,
    frames: Frames | None = None,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
) -> tuple[Finding, ...]:
    """List the findings of a layers file, the same as in its summary, with less work.

    Parameters
    ----------
    layers_file : LayersSource
        The file; read window by window.
    remedy : Remedy, optional
        Names in the commands; by default the name of the recording in the file.
    cause : callable, optional
        Tells why samples of some pixels were lost, where the recording is at hand.
    frames : callable, optional
        Tells which frames nearly all pixels show as moved, where the recording is at hand.
    thresholds : Thresholds
        From where on a finding is made.
    """
    tally = _FindingTally(layers_file, thresholds)
    tally.add_all()
    return tally.findings(remedy, cause, frames)


def remedy_for(
    provenance: Provenance, windows: int, recording: str | None = None, *, has_amplitude: bool | None = None
) -> Remedy:
    """The estimate that made a layers file, for the commands of its findings.

    `recording` is the name that a recording at hand has in a command; without it, the name in the file is taken.
    """
    options = provenance.options
    return Remedy(
        recording=provenance.source if recording is None else recording,
        noise=str(options.get("noise", "file")),
        window_frames=int(options.get("window", 2)),
        windows=windows,
        paper=bool(options.get("paper", False)),
        unmix=not (options.get("paper", False) or provenance.is_unmixed),
        has_amplitude=has_amplitude,
    )


class Counts:
    """Running counts over windows of what `info` tells of a layers file too."""

    def __init__(self, layers_file: LayersSource) -> None:
        self._frames = int(layers_file.window_stop[0] - layers_file.window_start[0])
        self.surfaces = [0] * (layers_file.max_layers + 1)
        self.suspicions = dict.fromkeys((suspicion.name for suspicion in SUSPICIONS), 0)
        self.lost = LostTally()
        self._status: dict[int, int] = {}

    def count(
        self,
        n_modes: ByteArray,
        status: ByteArray,
        suspect: NDArray[np.unsignedinteger] | None,
        invalid_share: Float32Array | None,
    ) -> None:
        """Count a window by its datasets; files of old versions lack the last two."""
        self.surfaces = _added(self.surfaces, n_modes)
        self.lost.add(invalid_share, status, self._frames)
        for name, count in count_suspects(suspect).items():
            self.suspicions[name] += count
        values, counts = np.unique(status, return_counts=True)
        for value, count in zip(values.tolist(), counts.tolist(), strict=True):
            self._status[value] = self._status.get(value, 0) + count

    def by_status(self) -> dict[str, int]:
        """Pixels by the names of `tofmix.flags.Status`; a value without a name is ``status_<value>``."""
        values = dict.fromkeys((*map(int, Status), *sorted(self._status)))
        return {status_name(value): self._status.get(value, 0) for value in values}


class _FindingTally(Counts):
    """Running counts over windows for the findings."""

    def __init__(self, layers_file: LayersSource, thresholds: Thresholds) -> None:
        super().__init__(layers_file)
        self._file = layers_file
        self._curve = noise_of(layers_file.provenance)
        self._thresholds = thresholds
        self.close = 0
        self.moved: list[list[MovedFrames]] = []
        self.dominant_ratio = ValueCounts()

    def add_all(self) -> None:
        """Add every window of the file."""
        starts, stops = self._file.window_start, self._file.window_stop
        for window in range(self._file.shape[0]):
            layers = self._file.read_window(window)
            self.add(layers)
            if moved := find_moved(layers, int(starts[window]), int(stops[window])):
                self.moved.append(moved)

    def add(self, window: Layers) -> None:
        self.count(window.n_modes, window.status, window.suspect, window.invalid_share)
        self.close += _close(window, self._file.provenance.unambiguous_range_mm, self._thresholds.close_sigmas)
        self.dominant_ratio.add(self.ratio(window)[window.weight > self._thresholds.dominant_weight])

    def ratio(self, window: Layers) -> FloatArray:
        """Sigma over the curve's, of each layer; NaN without a curve."""
        range_mm = window.range.astype(np.float64)
        ratio = np.full(range_mm.shape, np.nan)
        if self._curve is not None:
            known = np.isfinite(range_mm)
            ratio[known] = window.sigma[known] / self._curve.sigma(range_mm[known])
        return ratio

    def findings(self, remedy: Remedy | None, cause: Cause | None, frames: Frames | None) -> tuple[Finding, ...]:
        windows, rows, cols = self._file.shape
        provenance, law = self._file.provenance, self._file.mixing_law
        remedy = remedy or remedy_for(provenance, windows)
        curve = provenance.sensor.noise
        # With a law of amplitude, sigma is that of each pixel's own amplitude, which a layers file does not hold.
        by_range = curve is None or curve.law is None
        of_sigma = sigma_findings(
            count=self.dominant_ratio.count,
            median=self.dominant_ratio.quantiles(0.5)[0] if by_range else None,
            has_curve=curve is not None,
            remedy=remedy,
            thresholds=self._thresholds,
        )
        of_counts = count_findings(
            pixels=windows * rows * cols,
            by_status=self.by_status(),
            by_surfaces=self.surfaces,
            max_layers=self._file.max_layers,
            close=0 if provenance.sensor.filters_over_pixels else self.close,  # several layers are undecided there
            lost=self.lost.too_few,
            remedy=remedy,
            thresholds=self._thresholds,
        )
        of_losses = self.lost.findings(cause, thresholds=self._thresholds)
        of_light = light_findings(provenance.sensor, targets=provenance.targets, remedy=remedy)
        insisted = provenance.options.get("mixing") == "phasor"
        measured = law is not None and law.phasor_share >= DEFAULT_SETTINGS.law.least_phasor_share
        of_frames = frame_findings(
            sums=insisted or measured,
            total=int(self._file.window_stop[-1]) + provenance.frames_left_out,
            remedy=remedy,
        )
        of_filter = filter_findings(provenance.sensor.temporal_filter, remedy.window_frames)
        return (
            *moved_findings(self.moved, remedy, frames, targets=provenance.targets),
            *of_filter,
            *spatial_findings(provenance.sensor.neighbour_correlation, unmixed=provenance.is_unmixed),
            *of_sigma,
            *of_losses,
            *of_counts,
            *of_light,
            *of_frames,
            *target_findings(provenance.targets),
            *suspect_findings(self.suspicions),
        )


class _Tally(_FindingTally):
    """Running counts over windows for the summary."""

    def __init__(self, layers_file: LayersSource, thresholds: Thresholds) -> None:
        super().__init__(layers_file, thresholds)
        self.peaks = [0]
        self._layers = [_LayerTally() for _ in range(layers_file.max_layers)]
        self.no_return = ValueCounts()
        self.samples = ValueCounts()
        self.widths = ValueCounts()
        self.mixing = [0]
        self.undecided = [0] * (layers_file.max_layers + 1)

    def add(self, window: Layers) -> None:
        super().add(window)
        self.peaks = _added(self.peaks, window.n_peaks)
        self.no_return.add(window.weight_no_return)
        self.samples.add(window.n_samples.astype(np.float32))
        if window.noise_width is not None:
            self.widths.add(window.noise_width[window.n_modes > 0])
        if window.mixing is not None:
            self.mixing = _added(self.mixing, window.mixing)
            self.undecided = _added(self.undecided, window.n_modes[window.mixing == int(Mixing.UNDECIDED)])
        ratio = self.ratio(window)
        for k, layer in enumerate(self._layers):
            layer.range.add(window.range[..., k])
            layer.weight.add(window.weight[..., k])
            layer.stderr.add(window.range_stderr[..., k])
            layer.sigma.add(window.sigma[..., k])
            layer.ratio.add(ratio[..., k])

    def layer_summaries(self) -> tuple[LayerSummary, ...]:
        return tuple(
            LayerSummary(
                layer=k,
                count=tally.range.count,
                range_mm=spread_of(tally.range),
                weight_median=tally.weight.quantiles(0.5)[0],
                range_stderr_median_mm=tally.stderr.quantiles(0.5)[0],
                sigma_median_mm=tally.sigma.quantiles(0.5)[0],
                sigma_over_curve_median=tally.ratio.quantiles(0.5)[0],
            )
            for k, tally in enumerate(self._layers, start=1)
        )


class _LayerTally:
    """The values of one layer."""

    def __init__(self) -> None:
        self.range = ValueCounts()
        self.weight = ValueCounts()
        self.stderr = ValueCounts()
        self.sigma = ValueCounts()
        self.ratio = ValueCounts()


def _close(window: Layers, length: float | None, close_sigmas: float) -> int:
    """Pixels with two layers within `close_sigmas` of each other, across the fold of a circle as well."""
    gap = np.diff(window.range, axis=-1)
    sigma = np.maximum(window.sigma[..., 1:], window.sigma[..., :-1])
    with np.errstate(invalid="ignore"):
        close = (gap < close_sigmas * sigma).any(axis=-1)
    if length is not None:
        last = np.maximum(window.n_modes.astype(np.int64), 1)[..., np.newaxis] - 1
        far, sigma_far = (np.take_along_axis(values, last, -1)[..., 0] for values in (window.range, window.sigma))
        across = window.range[..., 0] + length - far
        with np.errstate(invalid="ignore"):
            close |= (window.n_modes > 1) & (across < close_sigmas * np.maximum(window.sigma[..., 0], sigma_far))
    return int(close.sum())


def noise_of(provenance: Provenance) -> NoiseCurve | None:
    """Return the curve with which sigmas are compared: the sensor's, on a circle continuous across the fold."""
    sensor, length = provenance.sensor, provenance.unambiguous_range_mm
    if length is None or sensor.noise is None:
        return sensor.noise
    try:
        return circular_noise(sensor, length, at_fold=False)
    except ValueError:
        return sensor.noise  # a circle that the estimator would have refused


def _added(totals: list[int], values: np.ndarray[Any, np.dtype[np.uint8]]) -> list[int]:
    """Add the counts of small integers to running ones, lengthening as needed."""
    counts = np.bincount(values.ravel()).tolist()
    return [a + b for a, b in zip_longest(totals, counts, fillvalue=0)]
