"""Figures for a notebook: an image of all pixels, or one pixel and its neighbours."""

from typing import TYPE_CHECKING

from tofmix.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tofmix.api.estimates import Estimate


def plot(layers: "Estimate", *, pixel: tuple[int, int] | None = None, window: int = 0, neighbours: int = 0) -> "Figure":
    """Draw the layers of an estimate.

    Parameters
    ----------
    layers : Estimate
        From `tofmix.estimate` or `tofmix.open`.
    pixel : (int, int), optional
        Row and column of one pixel: its samples, if the recording is available, their density and the fitted
        components. Without it, images of the nearest range and of the number of surfaces.
    window : int
        The window.
    neighbours : int
        Number of pixels of the same row that are drawn too.

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; ``figure.savefig("pixel.png")`` writes it.

    Raises
    ------
    IndexError
        If there is no such pixel or window.
    UsageError
        If Matplotlib is missing.
    """
    try:
        from tofmix.report.figures.pictures import overview_figure
        from tofmix.report.pixels.pixel_figures import neighbours_figure
        from tofmix.report.theme import LIGHT, drawing
    except ImportError as error:
        raise UsageError("plot needs matplotlib: pip install 'tofmix[report]'") from error
    from tofmix.report.pixels.pixels import learnt_sensor, neighbour_columns, row_samples, view_pixels

    windows, rows, cols = layers.shape
    if not 0 <= window < windows:
        raise IndexError(f"window {window}: there are windows 0 to {windows - 1}")
    one = layers.window(window)
    if pixel is None:
        with drawing(LIGHT):
            return _shown(overview_figure(one, name=layers.provenance.source, theme=LIGHT))
    row, col = pixel
    if not (0 <= row < rows and 0 <= col < cols):
        raise IndexError(f"pixel {row}, {col}: there are rows 0 to {rows - 1} and columns 0 to {cols - 1}")
    samples = None
    if layers.recording is not None:
        with layers.recording.opened() as source:
            samples = row_samples(
                source, row=row, start=int(layers.window_start[window]), stop=int(layers.window_stop[window])
            )
    circle_mm = layers.provenance.unambiguous_range_mm
    views = view_pixels(
        one,
        row=row,
        cols=neighbour_columns(col, cols=cols, neighbours=neighbours),
        samples=samples,
        noise=layers.sensor.noise,
        unambiguous_range_mm=circle_mm,
        learnt=learnt_sensor(layers.provenance),
    )
    with drawing(LIGHT):
        figure = neighbours_figure(views, noise=layers.sensor.noise, theme=LIGHT, unambiguous_range_mm=circle_mm)
        return _shown(figure)


def _shown(figure: "Figure") -> "Figure":
    """Let a notebook show the figure unchanged, for any Matplotlib settings."""

    def as_png() -> bytes:
        from io import BytesIO

        from tofmix.report.theme import LIGHT, drawing

        buffer = BytesIO()
        with drawing(LIGHT):
            figure.savefig(buffer, format="png")
        return buffer.getvalue()

    setattr(figure, "_repr_png_", as_png)  # noqa: B010  IPython's protocol; Figure does not declare it
    return figure
