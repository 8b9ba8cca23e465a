"""Warnings and notes on a layers file, in one sentence each.

A finding has a text and the commands to try. The thresholds (`Thresholds`) are for drawing attention, not tests:
nothing is refused here. `estimate`, `merge` and `report` print the same ones.

Notes on recordings of fewer frames than README asks for, with what is lost.

The figures are those of two tables by number of frames, and stand here alone in the code;
`tests/report/summary/test_findings.py` holds them to the tables.

Notes on the law of mixing: what a lock-in camera's recording lacks for unmixing, and what follows.
"""

import json
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from tofmix.bounds import Count, FactorThreshold, NotNegative, Share, Threshold, check_bounds
from tofmix.flags import Status, status_name
from tofmix.options import MAX_LAYERS_LIMIT
from tofmix.sensor import Sensor
from tofmix.suspicion import SUSPICIONS
from tofmix.temporal_filter import TemporalFilter
from tofmix.wording import counted


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """From where on a finding is made. They draw attention; they are no tests, and nothing is refused by them."""

    sigma_tolerance: Threshold = 0.10  # relative difference of the median sigma and the noise curve
    # Factor by which samples scatter more or less than the curve, at least 1. Two surfaces 3 sigma apart that samples
    # do not separate scatter sqrt(1 + 3^2 / 4) = 1.8 times as much.
    scatter_factor: FactorThreshold = 2.0
    # Share of the pixels with one unwelcome status, with every layer in use, with close layers, 0 to 1.
    status_share: Share = 0.05
    full_share: Share = 0.05
    close_share: Share = 0.05
    close_sigmas: NotNegative = 5.0  # distance of two layers of a pixel, in sigmas, below which they are close
    least_components: Count = 30  # fewest components for a statement about the curve
    # Components above this share, 0 to 1, test the noise curve; weak ones depend on the fit.
    dominant_weight: Share = 0.5
    # Iterations to advise where fits do not converge: four times the default of ``--max-iter``.
    more_iterations: Count = 200

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def drift_sigmas(self) -> float:
        """Drift over a window, sigmas: a steady change of D sigmas adds D^2 / 12 sigma^2 to a variance.

        Sigma then is larger by `sigma_tolerance`.
        """
        return math.sqrt(12.0 * ((1.0 + self.sigma_tolerance) ** 2 - 1.0))


DEFAULT_THRESHOLDS = Thresholds()


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One warning: `code` is stable and for scripts, `text` for people, `commands` are possible remedies.

    A note (`is_note`) says what a recording of its kind cannot show; nothing in it is doubtful.
    """

    code: str
    text: str
    commands: tuple[str, ...] = ()
    is_note: bool = False

    def as_dict(self) -> dict[str, str | list[str]]:
        """Return the same for JSON."""
        return {"code": self.code, "text": self.text, "commands": list(self.commands)}

    def without_commands(self) -> "Finding":
        """The same of samples that no command estimates."""
        return replace(self, commands=())

    @property
    def line(self) -> str:
        """All of it in one line."""
        return f"{self.text} Try: {', or: '.join(self.commands)}" if self.commands else self.text


def split_notes(findings: Iterable[Finding]) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Warnings, and notes, each in their order."""
    every = tuple(findings)
    return tuple(f for f in every if not f.is_note), tuple(f for f in every if f.is_note)


@dataclass(frozen=True, slots=True, kw_only=True)
class Remedy:
    """The estimate that findings are about: their remedies are the same command with another option."""

    recording: str  # the recording, as it is named in a command
    noise: str = "file"  # its option ``--noise``
    # Frames of a window, and how many windows there are.
    window_frames: int = 2
    windows: int = 1
    paper: bool = False  # its option ``--paper``
    unmix: bool = True  # whether pixels were to be unmixed where their samples are phasor sums
    has_amplitude: bool | None = None  # whether the recording has amplitudes; None if that is not known

    def import_command(self, *options: str) -> str:
        """The command that makes the recording again, with other options."""
        return shlex.join(["tofmix", "import", "SOURCE", "-o", self.recording, *options, "--overwrite"])

    def command(self, *options: str) -> str:
        """The command with other options."""
        kept = ("--paper",) if self.paper else ()
        return shlex.join(["tofmix", "estimate", self.recording, *kept, *options, "--overwrite"])

    def without_paper(self) -> str:
        """The command with the default procedure."""
        return shlex.join(["tofmix", "estimate", self.recording, "--overwrite"])

    def measure(self) -> str:
        """The command that measures the noise curve; where that was done, the one with a third of the window."""
        return self.shorter() if self.noise == "auto" else self.command("--noise", "auto")

    def shorter(self, window: int | None = None) -> str:
        """The command with a shorter window; by default a third, which has a ninth of a drift's variance."""
        return self.command("--window", str(max(1, self.window_frames // 3 if window is None else window)))


def sample_findings(
    *,
    scatter_over_curve: float | None,
    drift_sigmas: float | None,
    remedy: Remedy,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
) -> list[Finding]:
    """List contradictions between samples and noise curve, and drift within a window.

    Parameters
    ----------
    scatter_over_curve : float or None
        Standard deviation of a pixel's samples over the curve's sigma (median).
    drift_sigmas : float or None
        How far the ranges of a quarter of the pixels or more change over a window, in sigmas.
    remedy, thresholds : Remedy, Thresholds
        The estimate; from where on a finding is made.
    """
    found = []
    factor, drift = thresholds.scatter_factor, thresholds.drift_sigmas
    if scatter_over_curve is not None and not 1.0 / factor <= scatter_over_curve <= factor:
        averaged = ", as averaged or filtered ranges do" if scatter_over_curve < 1.0 else ""
        text = f"Samples scatter {scatter_over_curve:.2g} times as much as the noise curve says (median){averaged}."
        found.append(Finding(code="scatter_off_curve", text=text, commands=(remedy.measure(),)))
    if drift_sigmas is not None and drift_sigmas > drift:
        # Half of the size that is reported.
        window = int(0.5 * drift / drift_sigmas * remedy.window_frames)
        text = (
            f"In a quarter of the pixels ranges drift by {drift_sigmas:.1f} sigma or more within the"
            f" {remedy.window_frames} frames of a window, which can split one surface into two layers."
        )
        found.append(Finding(code="drift", text=text, commands=(remedy.shorter(window),)))
    return found


def _status_texts(remedy: Remedy, more_iterations: int) -> dict[Status, tuple[str, tuple[str, ...]]]:
    """The fault of the pixels of each status, and the commands that may mend it."""
    longer = (remedy.command("--window", str(2 * remedy.window_frames)),) if remedy.windows > 1 else ()
    more = (remedy.command("--max-iter", str(more_iterations)),)
    return {
        Status.TOO_FEW_SAMPLES: ("have fewer valid samples than --min-samples. Record more frames.", longer),
        Status.NOT_CONVERGED: ("did not converge; their layers are rough.", more),
        Status.DEGENERATE: ("have layers without a standard error: the samples do not determine it.", ()),
    }


def count_findings(
    *,
    pixels: int,
    by_status: Mapping[str, int],
    by_surfaces: Sequence[int],
    max_layers: int,
    remedy: Remedy,
    close: int = 0,
    lost: int = 0,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
) -> list[Finding]:
    """List findings from the counts of pixels over all windows.

    Parameters
    ----------
    pixels : int
        All pixels.
    by_status : mapping of str to int
        Those of each status name.
    by_surfaces : sequence of int
        Those with 0, 1, 2, ... surfaces.
    max_layers : int
        Layers that the file can hold.
    close : int
        Pixels with two layers within `close_sigmas` of each other.
    lost : int
        Pixels with too few samples for which more frames would not help: their light is not enough.
    remedy, thresholds : Remedy, Thresholds
        The estimate; from where on a finding is made.
    """
    found = []
    for status, (said, commands) in _status_texts(remedy, thresholds.more_iterations).items():
        count = by_status.get(status_name(status), 0) - (lost if status is Status.TOO_FEW_SAMPLES else 0)
        share = count / max(1, pixels)
        if share > thresholds.status_share:
            text = f"{100 * share:.1f} % of the pixels {said}"
            found.append(Finding(code=status_name(status), text=text, commands=commands))
    full = sum(by_surfaces[max_layers:]) / max(1, pixels)
    if max_layers > 1 and full > thresholds.full_share:
        most = min(2 * max_layers, MAX_LAYERS_LIMIT)
        more = () if max_layers >= most else (remedy.command("--max-layers", str(most)),)
        text = f"{100 * full:.1f} % of the pixels use all {max_layers} layers; there may be more."
        found.append(Finding(code="all_layers_used", text=text, commands=more))
    if close / max(1, pixels) > thresholds.close_share:
        text = (
            f"{100 * close / pixels:.1f} % of the pixels have two layers within {thresholds.close_sigmas:g} sigma of"
            " each other, which is rare. Causes: drift within a window, noise above the curve, a surface that is"
            " slanted or rough within a pixel (no option joins it)."
        )
        commands = tuple(dict.fromkeys((remedy.shorter(), remedy.measure())))
        if remedy.paper:  # its peaks are split by chance alone
            text = f"{text} --paper causes them too: it counts each peak as a surface."
            commands = (remedy.without_paper(),)
        found.append(Finding(code="close_layers", text=text, commands=commands))
    if pixels and pixels == sum(by_surfaces[:1]):
        found.append(Finding(code="no_surface_anywhere", text="No pixel shows a surface."))
    return found


def target_findings(targets: int) -> list[Finding]:
    """Explain shares if pixels return several targets a frame; `targets` is 0 if they do not."""
    if not targets:
        return []
    text = f"Each pixel has up to {targets} targets a frame. A share is the share of its detections, not of the beam."
    return [Finding(code="shares_of_detections", text=text)]


def suspect_findings(counts: Mapping[str, int]) -> list[Finding]:
    """Say how many layers are suspect; `counts` are those of each name in `tofmix.suspicion`."""
    said = [f"{counts[s.name]:,} {s.short} ({s.meaning})" for s in SUSPICIONS if counts.get(s.name)]
    if not said:
        return []
    text = f"Suspect layers: {'; '.join(said)}. map, export and surfaces leave them out without --suspect."
    return [Finding(code="suspect_layers", text=text)]


def filter_findings(found: TemporalFilter | None, frames: int) -> list[Finding]:
    """Warn of a camera that filters ranges over time: `frames` of a window tell less than they seem to."""
    if found is None or not found.blends:  # `repeat_findings` says values that are held
        return []
    text = (
        f"The camera filters ranges over time ({found.words()}): {counted(frames, 'such frame')} tell as much"
        f" as {found.worth(frames)} independent ones of that spread. Layers are of the independent samples."
        " Switch the camera's temporal filter off, and record again."
    )
    return [Finding(code="temporal_filter", text=text)]


def spatial_findings(correlation: float | None, *, unmixed: bool) -> list[Finding]:
    """Warn of a camera that filters ranges over pixels, by the correlation of their noise.

    `unmixed` says whether layers were unmixed where samples are phasor sums.
    """
    if correlation is None:
        return []
    text = (
        "The camera filters ranges over neighbouring pixels, whose noise has a correlation of"
        f" {correlation:.2f}: at edges, samples are of several pixels. Pixels of several surfaces are undecided, and"
        " ranges beside them are off by about sigma. Switch the camera's spatial filter off, and record again."
    )
    if unmixed:
        text += " For a filter that keeps edges, --mixing phasor keeps unmixed pixels."
    return [Finding(code="spatial_filter", text=text)]


def repeat_findings(share: float, of_frames: float, remedy: Remedy) -> list[Finding]:
    """Warn of samples that repeat the one before: their share, and the share of frames that repeat as a whole."""
    frames = remedy.window_frames
    text = (
        f"{100 * share:.0f} % of the samples repeat the one before, more than chance gives, as where a driver is read"
        f" faster than the camera measures. Layers are of the other samples: {counted(frames, 'such frame')} tell as"
        f" much as {max(1, round(frames * (1.0 - share)))}."
    )
    if of_frames < 0.5 * share:  # pixels repeat values one by one
        return [Finding(code="repeated_samples", text=f"{text} Read the camera at its own rate, and record again.")]
    light = ", amplitude=r.amplitude[new]" if remedy.has_amplitude else ""
    before, after = (
        json.dumps(str(name), ensure_ascii=False)  # the shell quotes the code by single quotes
        for name in (remedy.recording, Path(remedy.recording).with_suffix(".new.h5"))
    )
    code = (
        f"import numpy as np, tofmix; r = tofmix.open({before}); a = np.nan_to_num(r.range_mm);"
        " new = np.r_[True, (a[1:] != a[:-1]).any((1, 2))];"
        f' tofmix.from_array(r.range_mm[new], units="mm", sensor=r.sensor{light}).save({after})'
    )
    command = shlex.join(["python", "-c", code])
    return [Finding(code="repeated_samples", text=f"{text} Leave repeated frames out.", commands=(command,))]


def motion_findings(common_mm: float, alone_mm: float, remedy: Remedy, *, least_share: float = 0.5) -> list[Finding]:
    """Warn of frames that move as a whole, if they cause more than `least_share` of the sd of single samples."""
    each_mm = math.hypot(common_mm, alone_mm)
    if not common_mm > least_share * each_mm:
        return []
    text = (
        f"All ranges of a frame move together, by {common_mm:.3g} mm (sd) from frame to frame: a pixel's samples"
        f" scatter by {each_mm:.3g} mm, and by {alone_mm:.2g} mm without it. Sigma is wider by it, and near surfaces"
        " are not told apart. Take the motion of each frame out."
    )
    light = ", amplitude=r.amplitude" if remedy.has_amplitude else ""
    before, after = (
        json.dumps(str(name), ensure_ascii=False)
        for name in (remedy.recording, Path(remedy.recording).with_suffix(".still.h5"))
    )
    code = (
        f"import numpy as np, tofmix; r = tofmix.open({before}); a = r.range_mm[:, np.isfinite(r.range_mm).any(0)];"
        " moved = np.nanmedian(a - np.nanmedian(a, 0), 1);"
        ' tofmix.from_array(r.range_mm - moved[:, None, None], units="mm", sensor=r.sensor, time_s=r.time_s'
        f"{light}).save({after})"
    )
    return [Finding(code="frames_move", text=text, commands=(shlex.join(["python", "-c", code]),))]


def sigma_findings(
    *,
    count: int,
    median: float | None,
    has_curve: bool,
    remedy: Remedy,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
) -> list[Finding]:
    """List contradictions between fitted sigma and the sensor's noise curve, if it has one.

    `count` components were compared; `median` is that of their sigma over the curve.
    """
    if not has_curve:
        return [Finding(code="no_noise_curve", text="The file has no noise curve, so the report cannot check sigma.")]
    if median is None or count < thresholds.least_components or abs(median - 1.0) <= thresholds.sigma_tolerance:
        return []
    text = f"Sigma is {median:.2f} times the sensor's curve (median): the noise curve and the recording disagree."
    return [Finding(code="sigma_off_curve", text=text, commands=(remedy.measure(),))]


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedFrames:
    """Frames that README asks for, and the share found with fewer."""

    frames: int  # frames that are asked for
    found: MappingProxyType[int, float]  # share found by number of frames, ascending in both, up to `frames`
    what: str  # what is found, in words
    page: str  # the page with the table

    def finding(self, remedy: Remedy, total: int) -> list[Finding]:
        """A note if the windows of an estimate are shorter; `total` is the recording's number of frames.

        What is found with fewer frames than a row of the table is less than the row says.
        """
        window = remedy.window_frames
        if window >= self.frames:
            return []
        row = min(frames for frames in self.found if frames >= window)
        least = "less than " if row > window and self.found[row] > 0 else ""
        most = f"{least}{100 * self.found[row]:.3g} %"
        text = (
            f"{counted(window, 'frame')} a window; tofmix asks for {self.frames} or more. Of {self.what}, {most} are"
            f" found with {counted(window, 'frame')}, and {100 * self.found[self.frames]:.3g} % with {self.frames}"
            f" ({self.page})."
        )
        longer = total > window
        commands = (remedy.command("--window", str(min(total, self.frames))),) if longer else ()
        text += "" if longer else " Record more frames."
        return [Finding(code="few_frames", text=text, commands=commands, is_note=True)]


SINGLE_SAMPLES = AskedFrames(
    frames=25,
    found=MappingProxyType({3: 0.00, 5: 0.18, 7: 0.33, 10: 0.52, 15: 0.73, 20: 0.86, 25: 0.93}),
    what="surfaces with a fifth of a pixel's samples, 4 sigma before another",
    page="docs/results/limits.md#by-number-of-frames",
)
"""Where each sample is of one surface."""

PHASOR_SUMS = AskedFrames(
    frames=10,
    found=MappingProxyType({3: 0.998, 5: 0.998, 7: 0.999, 10: 0.999}),
    what="pixels with two surfaces far apart, whose light adds up",
    page="docs/results/mixing.md#by-number-of-frames",
)
"""Where samples are phasor sums."""


def frame_findings(*, sums: bool, total: int, remedy: Remedy) -> list[Finding]:
    """Say that the windows have fewer frames than README asks for.

    `sums`: samples at edges are phasor sums; `total`: frames of the recording.
    """
    return (PHASOR_SUMS if sums else SINGLE_SAMPLES).finding(remedy, total)


AMPLITUDES, FREQUENCY = "amplitudes", "modulation frequency"
"""What makes phasors of samples, in words."""

OPTIONS = {AMPLITUDES: ("--amplitude", "AMPLITUDES"), FREQUENCY: ("--modulation-frequency", "HZ")}
"""Options of ``tofmix import`` that add each, with a placeholder."""


def lacking(sensor: Sensor, *, has_amplitude: bool | None) -> tuple[str, ...]:
    """What a recording of one sample a frame lacks to be unmixed.

    Amplitudes of which nothing is known (`has_amplitude` is None) are not named.
    """
    amplitudes = (AMPLITUDES,) if has_amplitude is False else ()
    return (*amplitudes, *((FREQUENCY,) if sensor.modulation_frequency_hz is None else ()))


def light_findings(sensor: Sensor, *, targets: int, remedy: Remedy) -> list[Finding]:
    """Say that flying pixels are counted as surfaces, where layers are not unmixed though light may add up.

    A warning for a camera that is known as a lock-in camera, a note where the kind of camera is not known. Nothing for
    other cameras, such as those that return several `targets` a frame, which measure no phase, and where nobody wanted
    unmixing.
    """
    if sensor.is_lock_in is False or targets or not remedy.unmix:
        return []
    missing = lacking(sensor, has_amplitude=remedy.has_amplitude)
    if remedy.has_amplitude and not missing:
        return []  # --mixing events was chosen, or --paper
    without = f"has no {' and no '.join(missing)}" if missing else "has no amplitudes, or --mixing events was chosen"
    needs = "Unmixing needs ranges and amplitudes of one modulation frequency."
    # Amplitudes that the recording may have already are imported again with the ranges.
    options = [part for name in (AMPLITUDES, FREQUENCY) if name in (AMPLITUDES, *missing) for part in OPTIONS[name]]
    commands = (remedy.import_command(*options),)
    if sensor.is_lock_in:
        text = (
            f"The recording {without}: a lock-in camera's flying pixels, in which the light of several surfaces adds"
            f" up, are counted as surfaces. {needs}"
        )
        return [Finding(code="flying_pixels_counted", text=text, commands=commands)]
    text = (
        f"Mixing is not measured, because the recording {without}. If this is a lock-in camera, flying pixels are"
        f" counted as surfaces. {needs}"
    )
    return [Finding(code="mixing_not_measured", text=text, commands=commands, is_note=True)]
