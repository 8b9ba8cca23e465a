"""What the summary says beside names and numbers."""

import re

import numpy as np
from recordings import MAKE, reconciled

from tofmix.reconciliation.words import summary_lines
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.model import Model


def test_summary_tells_size_of_a_map_and_number_of_stuck_pixels(small: Model) -> None:
    image = small.sensor.rows, small.sensor.cols
    biases = np.random.default_rng(7).normal(0, 12, image).astype(np.float32)
    stuck = np.full(image, np.nan, dtype=np.float32)
    stuck.flat[::32] = 3000
    hidden = (
        MAKE["fixed_pattern"](map=PixelMap("biases.npy", biases)),
        MAKE["stuck_pixels"](map=PixelMap("stuck.npy", stuck)),
    )
    result = reconciled(small, *hidden, kinds=("fixed_pattern", "stuck_pixels"))
    said = "\n".join(summary_lines(result))
    assert 'stuck_pixels ("stuck_pixels.npy", 8 pixels)' in said
    (size,) = set(re.findall(r'fixed_pattern \("fixed_pattern.npy", ([\d.]+) mm rms\)', said))
    working = biases[np.isnan(stuck)]
    assert abs(float(size) - np.sqrt((working**2).mean())) < 1.5
