"""The options of ``tofmix estimate`` that hold for all of its recordings."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tofmix.estimation.settings import EstimateOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The options of all recordings; with `wrap`, each recording has the unambiguous range of its own camera."""

    options: "EstimateOptions"
    wrap: bool
    window: int | None
    stride: int | None
    noise: str | None
    outliers: str | float
    noise_shape: str
    noise_widths: str
    shares: str | None
    workers: int
    memory_bytes: int
    shard: tuple[int, int] | None
    resume: bool
    overwrite: bool
    scheduler: str | None
    force: bool
