"""One layer's ranges as a 16-bit grey PNG, with the scale in its text."""

import io

from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.exporters.image import RangeImage
from tofmix.io.extras import need


def write(file: AtomicFile, image: RangeImage) -> None:
    """Write the image; its ``Description`` names the scale."""
    counts = image.counts()
    pillow = need("PIL.Image", extra="export", what="PNG")
    text = need("PIL.PngImagePlugin", extra="export", what="PNG").PngInfo()
    text.add_text("Description", image.description())
    buffer = io.BytesIO()
    pillow.fromarray(counts).save(buffer, format="PNG", pnginfo=text)
    file.sink.write(buffer.getvalue())
