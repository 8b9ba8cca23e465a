"""What the fixture `make_layers` of tests/mapping returns."""

from collections.abc import Callable
from typing import TypeAlias

from tofmix.layers import Layers

MakeLayers: TypeAlias = Callable[..., Layers]
"""Layers that are the same in every pixel, from ranges and weights."""
