"""The suspicions, in the order of their flags."""

from tofmix.suspicion.declaration import Suspicion
from tofmix.suspicion.folded import FOLDED
from tofmix.suspicion.near_return import NEAR_RETURN
from tofmix.suspicion.passing import PASSING
from tofmix.suspicion.scattered_light import SCATTERED_LIGHT

SUSPICIONS: tuple[Suspicion, ...] = (
    SCATTERED_LIGHT,
    FOLDED,
    PASSING,
    NEAR_RETURN,
)
"""All suspicions; files have the flags and names, reports the words."""
