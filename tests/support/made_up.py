"""Layers that mean nothing but are consistent, for what reads and writes them."""

import numpy as np

from tofmix.flags import Status
from tofmix.layers import INVALID_SHARE, LAYER_FIELDS, Layers


def made_up_layers(shape: tuple[int, ...], max_layers: int, seed: int = 3) -> Layers:
    """Layers of a leading shape; every seventh pixel has an unknown standard error."""
    rng = np.random.default_rng(seed)
    layers = Layers.empty(shape, max_layers, (*LAYER_FIELDS, INVALID_SHARE))
    layers.n_modes[...] = rng.integers(0, max_layers + 1, shape)
    layers.n_peaks[...] = layers.n_modes
    present = np.arange(max_layers) < layers.n_modes[..., None]
    for name, low, high in (
        ("range", 300.0, 7400.0),
        ("sigma", 5.0, 90.0),
        ("range_stderr", 0.1, 9.0),
        ("weight_stderr", 0.0, 0.1),
        ("probability", 0.9, 1.0),
    ):
        values = rng.uniform(low, high, present.shape)
        getattr(layers, name)[present] = (np.sort(values, axis=-1) if name == "range" else values)[present]
    layers.weight[present] = 0.99 * rng.dirichlet(np.ones(max_layers), shape)[present].astype("f4")
    unknown = rng.random(shape) < 1 / 7
    layers.range_stderr[unknown] = np.nan
    layers.weight_outlier[...] = 1e-4
    layers.weight_no_return[...] = 1 - 1e-4 - np.nansum(layers.weight, -1)
    layers.log_likelihood[...] = -7.5
    layers.n_samples[...] = 20
    assert layers.invalid_share is not None
    layers.invalid_share[...] = 0
    layers.status[layers.n_modes == 0] = Status.NO_SURFACE
    layers.status[unknown & (layers.n_modes > 0)] = Status.DEGENERATE
    return layers


class LayersInMemory:
    """A `WindowSource` of an array."""

    def __init__(self, layers: Layers) -> None:
        windows, rows, cols = layers.shape
        self.layers = layers
        self.shape = windows, rows, cols
        self.max_layers = layers.max_layers

    def read_window(self, window: int) -> Layers:
        return Layers(**{spec.name: getattr(self.layers, spec.name)[window] for spec in self.layers.fields})
