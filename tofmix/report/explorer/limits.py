"""Limits of the samples in a page."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PageLimits:
    """Sizes of the explorer's data.

    Parameters
    ----------
    pixels : int
        Pixels of all windows of a page; one window is always there, unless it has more than `image_pixels`.
    windows : int
        Windows of a page, however small.
    image_pixels : int
        Pixels of an image beyond which a page has no explorer.
    samples : int
        Samples of all windows; of longer windows frames are left out.
    least_frames : int
        Samples a pixel below which none are shown: they show nothing.
    characters : int
        Most characters of the data: a page of one full image with pictures stays below 3 MB.
    sample_characters : int
        Characters that samples may take however much the layers take.
    """

    pixels: int = 60_000
    windows: int = 50
    image_pixels: int = 400_000
    samples: int = 4_000_000
    least_frames: int = 16
    characters: int = 2_400_000
    sample_characters: int = 200_000


DEFAULT_LIMITS = PageLimits()
