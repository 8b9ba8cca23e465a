"""One layer's ranges as a 16-bit grey TIFF, with the scale in its description."""

import io

from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.exporters.image import RangeImage
from tofmix.io.extras import need


def write(file: AtomicFile, image: RangeImage) -> None:
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
