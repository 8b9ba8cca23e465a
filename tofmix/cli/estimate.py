"""``tofmix estimate``: a recording in, a layers file out."""

import math
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from tofmix.cli.options import PATH, default_workers, examples, overwrite_option, progress_bar
from tofmix.cli.sensor_choice import circle_choice, circle_of, outlier_choice, sensor_for
from tofmix.errors import UsageError

if TYPE_CHECKING:
    from tofmix.estimation.counters import Counter
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.io.recording_file import RecordingFile
    from tofmix.windows import Windows

_COMPILING_AFTER_S = 4.0

COUNTER_OPTIONS = {"kde": ("gamma", "epsilon"), "cpdf": ("bins", "ratio"), "fourier": ("order", "level")}
"""The counters and their options: `tofmix.estimation.counters.COUNTERS` in words, for it imports numba."""


@examples(
    """
tofmix estimate sample_data/three_boards.h5 -o boards.layers.h5
tofmix estimate long.h5 --window 100 --stride 50
tofmix estimate foreign.h5 --noise auto --outliers auto
tofmix estimate foreign.h5 --noise sr3000 --sigma tied
tofmix estimate folded.h5 --wrap
tofmix estimate boards.h5 --counter cpdf --bins 30 -o cpdf.layers.h5
"""
)
@click.command(short_help="Recover the surfaces in each pixel of a recording.")
@click.argument("recording", type=PATH)
@click.option("-o", "--output", type=PATH, help="Layers file to write.  [default: RECORDING with .layers.h5]")
@click.option("--window", type=click.IntRange(1), help="Frames that make one estimate.  [default: all]")
@click.option("--stride", type=click.IntRange(1), help="Frames from one window to the next.  [default: the window]")
@click.option(
    "--sigma",
    type=click.Choice(["tied", "prior", "free"]),
    default="prior",
    show_default=True,
    help="A surface's sigma: the noise curve's, drawn towards it, or free as in the paper.",
)
@click.option(
    "--noise", default="file", show_default=True, metavar="file|auto|PROFILE",
    help="Where the noise curve comes from: the file, its samples (auto), or a built-in sensor such as sr3000.",
)  # fmt: skip
@click.option(
    "--outliers", default="file", show_default=True, metavar="file|auto|P",
    help="Share of random values p(c_r): the file's, counted in its samples (auto), or a number.",
)  # fmt: skip
@click.option(
    "--max-layers", type=click.IntRange(1, 32), default=6, show_default=True, help="Most surfaces in a pixel."
)
@click.option(
    "--refine", type=click.Choice(["likelihood", "none"]), default="likelihood", show_default=True,
    help="Count surfaces by likelihood, from the peaks on; or take the peaks for the surfaces, as in the paper.",
)  # fmt: skip
@click.option(
    "--false-alarm", type=click.FloatRange(1e-6, 0.1), default=0.001, show_default=True,
    help="Chance that a pixel of one surface gets more than one; with --refine likelihood.",
)  # fmt: skip
@click.option(
    "--counter", type=click.Choice(tuple(COUNTER_OPTIONS)), default="kde", show_default=True,
    help="What finds the peaks: the kernel density, or what the paper tried before it, for comparison.",
)  # fmt: skip
@click.option(
    "--gamma", type=click.FloatRange(0, 1, max_open=True), default=0.02, show_default=True,
    help="kde: least share of the samples that makes a peak in the density.",
)  # fmt: skip
@click.option(
    "--epsilon", type=click.FloatRange(0, min_open=True), default=0.01, show_default=True,
    help="kde: largest slope at a peak, in units of p(r) / h(r).",
)  # fmt: skip
@click.option(
    "--bins", type=click.IntRange(2, 100), default=15, show_default=True,
    help="cpdf: bins of the cumulative distribution over the working range.",
)  # fmt: skip
@click.option(
    "--ratio", type=click.FloatRange(1, 10, min_open=True), default=1.1, show_default=True,
    help="cpdf: k of F(r) = P(k r) - P(r).",
)  # fmt: skip
@click.option(
    "--order", type=click.IntRange(1, 64), default=16, show_default=True, help="fourier: last term of the series."
)
@click.option(
    "--level", type=click.FloatRange(0, 1, max_open=True), default=0.1, show_default=True,
    help="fourier: least share of the samples that makes a peak in the series.",
)  # fmt: skip
@click.option(
    "--unambiguous-range", type=click.FloatRange(0, min_open=True), metavar="MM",
    help="Take range as a circle of this length: a surface at the fold is one surface.",
)  # fmt: skip
@click.option("--wrap", is_flag=True, help="The same, with c / 2f of the recording's modulation frequency f.")
@click.option("--max-iter", type=click.IntRange(1, 65535), default=50, show_default=True, help="Most EM iterations.")
@click.option(
    "--tol", type=click.FloatRange(0, 1, min_open=True, max_open=True), default=1e-3, show_default=True,
    help="EM stops when no mean moves by this many sigma, no share by this.",
)  # fmt: skip
@click.option(
    "--min-samples", type=click.IntRange(2), default=3, show_default=True,
    help="Fewest valid samples that a pixel is fitted with.",
)  # fmt: skip
@click.option("--workers", type=click.IntRange(1), help="Threads; results do not depend on it.  [default: all cores]")
@click.option(
    "--chunk-mb", type=click.FloatRange(0, min_open=True), default=64.0, show_default=True,
    help="Memory for a block of samples; results do not depend on it.",
)  # fmt: skip
@overwrite_option
@click.pass_context
def estimate(
    context: click.Context,
    /,
    recording: Path,
    output: Path | None,
    window: int | None,
    stride: int | None,
    noise: str,
    outliers: str,
    unambiguous_range: float | None,
    wrap: bool,
    workers: int | None,
    chunk_mb: float,
    overwrite: bool,
    **choices: float | str,
) -> None:
    """Recover the surfaces in each pixel of RECORDING, an HDF5 file.

    For each pixel, the peaks of the kernel density of its samples are where surfaces
    are looked for; expectation-maximisation finds their ranges, shares and sigmas.
    Surfaces that the samples do not need are taken out, and others are added where
    the likelihood asks for them. The result is a layers file with the dimensions
    window, row, col and layer, near to far.
    """
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.io.recording_file import open_recording
    from tofmix.io.storage import check_output
    from tofmix.windows import plan_windows

    if not math.isfinite(chunk_mb):
        raise UsageError(f"--chunk-mb: {chunk_mb} is not a number of megabytes")
    if stride is not None and window is None:
        raise UsageError("--stride goes with --window")
    target = output or recording.with_name(recording.stem + ".layers.h5")
    if choices["refine"] == "none" and context.get_parameter_source("false_alarm") is not ParameterSource.DEFAULT:
        raise UsageError("--false-alarm belongs to --refine likelihood, not to --refine none")
    try:
        counter = _counter(context, choices)
        length = circle_choice(unambiguous_range, wrap=wrap)
        options = EstimateOptions(counter=counter, unambiguous_range_mm=length, **choices)  # type: ignore[arg-type]  # click has checked the types
    except ValueError as error:
        raise UsageError(str(error)) from error
    choice = outlier_choice(outliers)
    with open_recording(recording) as source:
        check_output(target, overwrite=overwrite, inputs=(recording,))
        if wrap:
            options = replace(options, unambiguous_range_mm=circle_of(source))
        source.sensor = sensor_for(source, noise=noise, outliers=choice, circle_mm=options.unambiguous_range_mm)
        try:
            windows = plan_windows(source.shape[0], window=window, stride=stride)
        except ValueError as error:
            raise UsageError(f"{recording}: {error}") from error
        _run(
            source,
            windows,
            options,
            {"noise": noise, "outliers": choice},
            target,
            workers or default_workers(),
            chunk_mb,
            overwrite,
        )


def _counter(context: click.Context, choices: dict[str, Any]) -> "Counter":
    """Take the counter and its options out of the choices; options of another counter are refused."""
    from tofmix.estimation.counters import COUNTERS

    kind, own = choices.pop("counter"), {}
    for owner, names in COUNTER_OPTIONS.items():
        for name in names:
            value = choices.pop(name)
            if owner == kind:
                own[name] = value
            elif context.get_parameter_source(name) is not ParameterSource.DEFAULT:
                raise UsageError(f"--{name} belongs to --counter {owner}, not to --counter {kind}")
    return COUNTERS[kind](**own)


def _run(
    source: "RecordingFile",
    windows: "Windows",
    options: "EstimateOptions",
    of_sensor: dict[str, str | float],
    target: Path,
    workers: int,
    chunk_mb: float,
    overwrite: bool,
) -> None:
    from tofmix import __version__
    from tofmix.estimation.sequence import estimate_windows, tile_shape
    from tofmix.io.layers_file import LayersWriter
    from tofmix.io.recording_file import file_sha256
    from tofmix.layers import Provenance

    _, rows, cols = source.shape
    provenance = Provenance(
        source=source.path.name,
        source_sha256=file_sha256(source.path),
        version=__version__,
        sensor=source.sensor,
        options=options.as_dict() | of_sensor | {"window": windows.length, "stride": windows.stride},
        frames_left_out=windows.frames_left_out,
    )
    writer = LayersWriter(
        target,
        windows=windows,
        image=(rows, cols),
        max_layers=options.max_layers,
        tile=tile_shape(windows.count, rows, cols),
        provenance=provenance,
        overwrite=overwrite,
        inputs=(source.path,),
    )
    counts = [0] * (options.max_layers + 1)
    with writer, progress_bar(windows.count * rows * cols, "estimate", "px") as bar:
        _compile(options)
        for batch in estimate_windows(
            source, windows, options, workers=workers, chunk_mb=chunk_mb, progress=bar.update
        ):
            writer.write(batch.windows, slice(0, rows), batch.layers)
            for n in range(len(counts)):
                counts[n] += int((batch.layers.n_modes == n).sum())
    if windows.frames_left_out:
        left_out = f"{windows.frames_left_out} frame{'s' * (windows.frames_left_out > 1)}"
        click.echo(f"tofmix: {source.path}: {left_out} after the last whole window left out", err=True)
    found = ", ".join(f"{n}: {count:,}" for n, count in enumerate(counts) if count)
    click.echo(
        f"{target}: {rows} x {cols} pixels, {windows.count} window{'s' * (windows.count > 1)} of {windows.length}"
        f" frames; pixels by surfaces {found}"
    )


def _compile(options: "EstimateOptions") -> None:
    """Compile the kernels, or load them from their cache; say so where it takes long."""
    from tofmix.estimation.layering import warm_up

    text = "tofmix: compiling the kernels; a first run takes about half a minute longer"
    timer = threading.Timer(_COMPILING_AFTER_S, click.echo, (text,), {"err": True})
    timer.start()
    try:
        warm_up(options)
    finally:
        timer.cancel()
