"""Summarise a layers file, alone or with its recording, or compare two of them, and write the page.

What only pages or samples need is imported where it is used: it is slow to import.
"""

from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tofmix.errors import BadInputError
from tofmix.io.layers.layers_file import LayersFile, open_layers
from tofmix.io.recording.recording_file import file_sha256
from tofmix.io.storage import locked, write_text
from tofmix.io.surfaces_file import open_surfaces
from tofmix.jobs.files import check_recording, check_window, findings_of_samples, opened_recording
from tofmix.jobs.reporter import Reporter
from tofmix.recording import SampleSource
from tofmix.report.comparison import Comparison, compare, render_comparison
from tofmix.report.summary.lost import cause_of_loss
from tofmix.report.summary.moved_frames import moved_frames
from tofmix.report.summary.summary import Summary, remedy_for, summarise

if TYPE_CHECKING:
    from tofmix.report.pixels.single_pixels import SinglePixels


def report_layers(
    layers: Path,
    reporter: Reporter,
    *,
    recording: Path | None,
    surfaces: Path | None,
    html: Path | None,
    window: int,
    overwrite: bool,
) -> Summary:
    """Summarise a layers file, and write the page `html` of one window and its `surfaces`, if it is wanted."""
    inputs = tuple(path for path in (layers, recording, surfaces) if path is not None)
    with ExitStack() as stack:
        file = stack.enter_context(open_layers(layers))
        source = None if recording is None else stack.enter_context(opened_recording(recording, reporter))
        if source is not None:
            check_recording(file, source)
        check_window(file, window, reporter)
        if html is not None:
            stack.enter_context(locked(html, overwrite=overwrite, inputs=inputs))
        singles = None
        if source is None:
            summary = summarise(file)
        else:
            made = file.provenance
            remedy = remedy_for(made, file.shape[0], str(recording), has_amplitude=source.has_amplitude)
            of_samples = findings_of_samples(source, made.sensor, made.unambiguous_range_mm, remedy)
            summary = summarise(
                file, remedy, cause=partial(cause_of_loss, source), frames=partial(moved_frames, source)
            )
            summary = summary.with_findings((*of_samples, *summary.warnings, *summary.notes))
            if summary.noise is not None:
                singles = _singles(file, window, source)
                summary = replace(summary, noise=replace(summary.noise, scatter_over_sigma=singles.spread()))
        if html is not None:
            from tofmix.report.page import render_page

            shown: dict[str, Any] = {} if surfaces is None else _surfaces_of(surfaces, layers, window)
            page = render_page(file, recording=source, window=window, summary=summary, singles=singles, **shown)
            write_text(html, page, overwrite=overwrite, inputs=inputs)
        return summary


def _singles(file: LayersFile, window: int, source: SampleSource) -> "SinglePixels":
    """How far samples of single pixels scatter."""
    from tofmix.report.pixels.single_pixels import single_pixels

    start, stop = int(file.window_start[window]), int(file.window_stop[window])
    try:
        return single_pixels(file.read_window(window), file.provenance, recording=source, start=start, stop=stop)
    except ValueError as error:  # a noise or a working range that no estimate could have had
        raise BadInputError(f"{file.path}: {error}") from error


def _surfaces_of(path: Path, layers: Path, window: int) -> dict[str, Any]:
    """Surfaces of a window for the page."""
    with open_surfaces(path) as file:
        if file.provenance.source_sha256 != file_sha256(layers):
            raise BadInputError(
                f"{path}: made from another layers file than {layers}; replace it: tofmix surfaces {layers} --overwrite"
            )
        found = file.read_window(window)
    numbers = found.surface[found.surface >= 0]
    return {"surfaces": found, "first_surface": int(numbers.min()) if len(numbers) else 0}


def compare_layers(
    a: Path, b: Path, reporter: Reporter, *, tolerance: float, html: Path | None, window: int | None, overwrite: bool
) -> Comparison:
    """Compare two layers files; write the page `html`, which shows one window, if it is wanted."""
    with ExitStack() as stack:
        files = [stack.enter_context(open_layers(path)) for path in (a, b)]
        if html is not None:
            stack.enter_context(locked(html, overwrite=overwrite, inputs=(a, b)))
        check_window(files[0], window, reporter)
        try:
            comparison = compare(*files, tolerance=tolerance)
        except BadInputError as error:
            raise BadInputError(f"{a} and {b}: {error}") from error
        if html is not None:
            page = render_comparison(*files, comparison=comparison, window=window, names=(a.name, b.name))
            write_text(html, page, overwrite=overwrite, inputs=(a, b))
        return comparison
