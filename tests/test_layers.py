"""Layers keep one shape through every array, and the file's list is theirs."""

from dataclasses import fields

import numpy as np

from tofmix.layers import LAYER_FIELDS, OPTIONAL_FIELDS, Layers


def test_the_list_and_the_class_agree() -> None:
    assert [f.name for f in fields(Layers)] == [spec.name for spec in (*LAYER_FIELDS, *OPTIONAL_FIELDS)]
    assert len({spec.name for spec in LAYER_FIELDS}) == len(LAYER_FIELDS)


def test_empty_layers_have_zero_counts_and_nan_values() -> None:
    layers = Layers.empty((2, 3), 4)
    assert layers.shape == (2, 3)
    assert layers.max_layers == 4
    for spec in LAYER_FIELDS:
        values = getattr(layers, spec.name)
        assert values.shape == ((2, 3, 4) if spec.per_layer else (2, 3))
        assert values.dtype == np.dtype(spec.dtype)
        assert np.isnan(values).all() if spec.dtype == "f4" else not values.any()


def test_reshaped_layers_share_their_arrays() -> None:
    layers = Layers.empty((6,), 2)
    image = layers.reshaped((2, 3))
    layers.range[5, 1] = 7.0
    assert image.range[1, 2, 1] == 7.0
    assert [a.shape for a in image.arrays()] == [a.reshape(2, 3, *a.shape[1:]).shape for a in layers.arrays()]
