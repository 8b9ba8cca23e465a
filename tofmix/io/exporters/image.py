"""Ranges as whole numbers of 16 bits, in grey PNG and TIFF whose text names the scale."""

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array
from tofmix.errors import BadInputError
from tofmix.io.next_command import need
from tofmix.io.storage import AtomicFile

_LARGEST = np.iinfo(np.uint16).max  # largest count that a 16-bit image stores


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RangeImage:
    """Ranges of one layer, or those of a finer image."""

    range_mm: Float32Array  # (row, col) float32: Ranges, mm; NaN for none
    scale_mm: float  # mm of one count, above 0
    title: str  # where they are from; one line of ASCII
    none: str = "no layer"  # meaning of a count of 0

    def counts(self) -> NDArray[np.uint16]:
        """Nearest whole counts (row, col) uint16; 0 for none."""
        known = np.isfinite(self.range_mm)
        counts = np.rint(self.range_mm.astype(np.float64) / self.scale_mm)
        bad = known & ~((counts >= 1) & (counts <= _LARGEST))
        if bad.any():
            value = float(self.range_mm[bad][0])
            raise BadInputError(
                f"a range of {value:g} mm does not fit into 16 bits at {self.scale_mm:g} mm a count;"
                " choose another --scale"
            )
        return np.where(known, counts, 0).astype(np.uint16)

    def description(self) -> str:
        """Meaning of a count, in one line for the header of the file."""
        return f"{self.title}; radial range, 1 count = {self.scale_mm:.9g} mm, 0 = {self.none}"


def write_png(file: AtomicFile, image: RangeImage) -> None:
    """Write the image; its ``Description`` names the scale."""
    counts = image.counts()
    pillow = need("PIL.Image", extra="export", what="PNG")
    text = need("PIL.PngImagePlugin", extra="export", what="PNG").PngInfo()
    text.add_text("Description", image.description())
    buffer = io.BytesIO()
    pillow.fromarray(counts).save(buffer, format="PNG", pnginfo=text)
    file.sink.write(buffer.getvalue())


def write_tiff(file: AtomicFile, image: RangeImage) -> None:
    """Write the image; its ``ImageDescription`` names the scale."""
    counts = image.counts()
    tifffile = need("tifffile", extra="export", what="TIFF")
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        counts,
        photometric="minisblack",
        compression="zlib",
        description=image.description(),
        metadata=None,
        software=False,
    )
    file.sink.write(buffer.getvalue())
