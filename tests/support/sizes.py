"""How much a test takes where kernels run as plain Python."""

from typing import TypeVar

from tofmix.compiled.kept import config

T = TypeVar("T")


def sized(compiled: T, plain: T) -> T:
    """Return `compiled`, or `plain` where numba's JIT is off and a pixel takes some hundred times as long.

    For numbers of pixels, frames or examples. What is asserted must hold for both, and be able to fail with both.
    """
    return plain if config.DISABLE_JIT else compiled
