"""The report as one HTML page that needs nothing else, not even a network.

For the terminal use `tofmix.report.summary.tables`, for scripts `Summary.as_dict`. This
is the one module that needs the extra ``report``, and only when it is called.
"""

import base64
import hashlib
from dataclasses import replace
from importlib import import_module

from tofmix.errors import UsageError
from tofmix.layers import LayersSource, Provenance
from tofmix.optics.projection import projection_values
from tofmix.recording import SampleSource
from tofmix.report.averaging import AveragedImage, average_window
from tofmix.report.pixels.single_pixels import SinglePixels, single_pixels
from tofmix.report.summary.summary import Summary, noise_of, summarise
from tofmix.report.summary.tables import ordinal
from tofmix.report.templates import load_template, read_part
from tofmix.sensor import Sensor
from tofmix.surfaces.found import WindowSurfaces
from tofmix.suspicion import SUSPICIONS
from tofmix.wording import counted

SCRIPTS = tuple(f"{name}.js" for name in ("explorer_data", "explorer_plots", "explorer", "explorer_views"))

Row = tuple[str, str]


def render_page(
    layers_file: LayersSource,
    *,
    recording: SampleSource | None = None,
    window: int = 0,
    summary: Summary | None = None,
    singles: SinglePixels | None = None,
    surfaces: WindowSurfaces | None = None,
    first_surface: int = 0,
) -> str:
    """Render the page of a layers file as HTML; the same input gives the same text.

    Parameters
    ----------
    layers_file : LayersSource
        For example an open `tofmix.io.layers.layers_file.LayersFile`.
    recording : SampleSource, optional
        Source of the layers, for the averaged image; without it that image is the mean of the layers.
    window : int
        The window of the pictures, from 0.
    summary, singles : Summary, SinglePixels, optional
        From `summarise` and from `single_pixels` of this window; without them they are made.
    surfaces, first_surface : WindowSurfaces, int, optional
        Surfaces of this window, and the number of the first; without them the page has no part about surfaces.
    """
    n_windows, rows, cols = layers_file.shape
    if not 0 <= window < n_windows:
        raise UsageError(f"window {window}: the file has windows 0 to {n_windows - 1}")
    if recording is not None and recording.shape[1:] != (rows, cols):
        raise UsageError(
            f"recording: {recording.shape[1]} x {recording.shape[2]} pixels, the layers have {rows} x {cols}; "
            "pass the one the layers were made from"
        )
    template = load_template("page.html")
    layers = layers_file.read_window(window)
    frames = int(layers_file.window_start[window]), int(layers_file.window_stop[window])
    provenance = layers_file.provenance
    averaged = average_window(layers_file, window, layers, recording)
    summary = summary or summarise(layers_file)
    pictures = import_module("tofmix.report.figures.pictures")
    rasters = import_module("tofmix.report.figures.picture")
    sensor = replace(provenance.sensor, noise=noise_of(provenance), range_step_mm=None)
    scale: tuple[float, float] = pictures.range_scale(layers, averaged, sensor)
    explorer = import_module("tofmix.report.explorer").make_explorer(
        layers_file, recording=recording, window=window, layers=layers, averaged=averaged, scale=scale
    )
    noise_pictures = None
    if summary.noise is not None:
        start, stop = frames
        singles = singles or single_pixels(layers, provenance, recording=recording, start=start, stop=stop)
        draw_noise = import_module("tofmix.report.figures.noise_pictures").draw_noise
        noise_pictures = draw_noise(layers, provenance, singles, summary.noise)
    mixing = None
    if summary.mixing is not None and layers.mixing is not None:
        mixing = pictures.draw_mixing(layers.mixing, summary.mixing)
    surfaces_part = None
    if surfaces is not None:
        draw_surfaces = import_module("tofmix.report.figures.surface_pictures").draw_surfaces
        surfaces_part = draw_surfaces(surfaces, layers, first=first_surface, scale=scale)
    script = page_script()
    return template.render(
        source=provenance.source,
        headline=headline(summary),
        window_text=_window_text(summary, window, frames),
        averaged_text=_averaged_text(averaged, recorded=recording is not None),
        summary=summary,
        suspicions=SUSPICIONS,
        ordinal=ordinal,
        gallery=pictures.draw_gallery(layers, averaged, sensor, scale=scale, frames=frames[1] - frames[0]),
        explorer=explorer,
        plane=rasters.Plane(*layers.shape),
        script=script,
        script_sha256=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii"),
        options=[(name, str(value)) for name, value in sorted(provenance.options.items())],
        sensor=_sensor_rows(provenance),
        noise=_noise_rows(provenance),
        noise_pictures=noise_pictures,
        mixing=mixing,
        surfaces=surfaces_part,
        provenance=_provenance_rows(summary, provenance.sensor.name),
    )


def headline(summary: Summary) -> str:
    """Describe the result in one sentence, for example ``25,344 pixels, 1 window of 100 frames: 13 % see ...``."""
    windows = f"{counted(summary.windows, 'window', ',')} of {counted(summary.window_frames, 'frame', ',')}"
    pixels = counted(summary.rows * summary.cols, "pixel", ",")
    unsure, all_pixels = summary.undecided_by_surfaces, max(1, summary.pixels)
    several = percent(summary.share_several_surfaces - sum(unsure[2:]) / all_pixels)
    none = percent(summary.share_no_surface - sum(unsure[:1]) / all_pixels)
    undecided = f", {percent(sum(unsure) / all_pixels)} are undecided" if any(unsure) else ""
    return f"{pixels}, {windows}: {several} see more than one surface, {none} see none{undecided}."


def percent(share: float) -> str:
    """Write a share as ``13 %``; ``less than 1 %`` and ``more than 99 %`` where rounding would give none or all."""
    if share <= 0:
        return "0 %"
    per_cent = f"{100 * share:.0f} %"
    return {"0 %": "less than 1 %", "100 %": "100 %" if share == 1 else "more than 99 %"}.get(per_cent, per_cent)


def page_script() -> str:
    """Return the script of the page: its files one after the other, out of reach of anything else."""
    parts = "".join(read_part(name) for name in SCRIPTS)
    return f'(() => {{\n"use strict";\n{parts}}})();'


def _window_text(summary: Summary, window: int, frames: tuple[int, int]) -> str:
    text = f"frames {frames[0]} to {frames[1] - 1}"
    if summary.windows == 1:
        return f"The pictures show the one window, {text}."
    return f"The pictures show window {window} of 0 to {summary.windows - 1}, {text}; the tables count all windows."


def _averaged_text(averaged: AveragedImage, *, recorded: bool) -> str:
    text = f"The averaged image is the {averaged.averaging}."
    return text if recorded else f"{text} With --recording it is made from the samples themselves."


def _sensor_rows(provenance: Provenance) -> list[Row]:
    sensor = provenance.sensor
    values = (
        ("modulation frequency", sensor.modulation_frequency_hz, 1e-6, "MHz"),
        ("integration time", sensor.integration_time_ms, 1.0, "ms"),
        ("least range", sensor.range_min_mm, 1.0, "mm"),
        ("largest range", sensor.range_max_mm, 1.0, "mm"),
        *_view_values(sensor),
        ("outlier probability p(c_r)", sensor.outlier_probability, 1.0, ""),
    )
    rows = [(name, "not known" if v is None else f"{v * factor:g} {unit}".strip()) for name, v, factor, unit in values]
    return [("name", sensor.name), *rows]


def _view_values(sensor: Sensor) -> list[tuple[str, float | None, float, str]]:
    """Numbers of the projection."""
    if sensor.projection is None:
        names = (("horizontal", sensor.fov_horizontal_deg), ("vertical", sensor.fov_vertical_deg))
        return [(f"field of view, {name}", value, 1.0, "degrees") for name, value in names]
    rows: list[tuple[str, float | None, float, str]] = []
    for key, value in projection_values(sensor.projection).items():
        if isinstance(value, tuple):
            rows += [(f"{sensor.projection.name}, {key} {n}", part, 1.0, "") for n, part in enumerate(value, 1)]
        else:
            rows.append((f"{sensor.projection.name}, {key}", value, 1.0, "pixels"))
    return rows


def _noise_rows(provenance: Provenance) -> list[Row]:
    curve = provenance.sensor.noise
    if curve is None:
        return []
    return [(f"{r:g}", f"{s:.3g}") for r, s in zip(curve.range_mm.tolist(), curve.sigma_mm.tolist(), strict=True)]


def _provenance_rows(summary: Summary, sensor: str) -> list[Row]:
    return [
        ("recording", summary.source),
        ("SHA-256 of the recording", summary.source_sha256),
        ("estimated by tofmix", summary.version),
        ("image", f"{counted(summary.rows, 'row')} x {counted(summary.cols, 'column')}"),
        ("windows", f"{summary.windows} of {counted(summary.window_frames, 'frame')}"),
        ("frames left out at the end", f"{summary.frames_left_out}"),
        *(() if summary.lost is None else (("lost samples", summary.lost.line),)),
        ("options of estimate", ", ".join(f"{name} {value}" for name, value in summary.options.items()) or "none"),
        ("sensor", sensor),
    ]
