"""What the fixtures `make_layers`, `make_source` and `make_recording` return."""

from collections.abc import Callable
from typing import TypeAlias

from tofmix.layers import Layers, LayersSource
from tofmix.recording import SampleSource

MakeLayers: TypeAlias = Callable[..., Layers]
"""Layers that are the same in every pixel, from ranges and weights."""
MakeSource: TypeAlias = Callable[..., LayersSource]
MakeRecording: TypeAlias = Callable[..., SampleSource]
