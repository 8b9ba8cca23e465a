"""Limits of the samples in a page."""

from dataclasses import dataclass

from tofmix.bounds import WholeNumber, check_bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class PageLimits:
    """Sizes of the explorer's data."""

    # Pixels of all windows of a page; one window is always there, unless it has more than `image_pixels`.
    pixels: WholeNumber = 60_000
    windows: WholeNumber = 50  # windows of a page, however small
    image_pixels: WholeNumber = 400_000  # pixels of an image beyond which a page has no explorer
    samples: WholeNumber = 4_000_000  # samples of all windows; of longer windows frames are left out
    least_frames: WholeNumber = 16  # samples a pixel below which none are shown: they show nothing
    # Most characters of the data: a page of one full image with pictures stays below 3 MB.
    characters: WholeNumber = 2_400_000
    sample_characters: WholeNumber = 200_000  # characters that samples may take however much the layers take

    def __post_init__(self) -> None:
        check_bounds(self)


DEFAULT_LIMITS = PageLimits()
