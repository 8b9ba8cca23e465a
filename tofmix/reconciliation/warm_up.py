"""Compile the kernels of reconciliation by using each once."""

from dataclasses import replace

import numpy as np

from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.likelihood.memory import RandomValues, memory_gain, predicted_noise
from tofmix.reconciliation.search import links
from tofmix.simulation.casting.polygon_cast import PolygonCaster
from tofmix.simulation.model import Model

_FRAMES = 20  # as few as are taken


def warm_up(model: Model) -> None:
    """Compile the kernels of `reconcile`, except those of simulation, or load them from the cache.

    Parameters
    ----------
    model : Model
        Any one.
    """
    PolygonCaster(model.sensor).cast(model)  # 6 x 6 pixels are too wide for it
    model = replace(model, sensor=replace(model.sensor, rows=6, cols=6))
    range_mm = np.random.default_rng(1).normal(1500.0, 10.0, (_FRAMES, 6, 6)).astype(np.float32)
    likelihood = joint_likelihood([(model, make_evidence(model, range_mm))])
    state, mixture = likelihood.start(), likelihood.scene.mixture()
    everything = np.arange(_FRAMES), np.arange(36)
    likelihood.sums(mixture, state, everything)
    likelihood.sums(replace(mixture, step=7.0), state, everything)  # a lattice: sample by sample
    likelihood.scores(state, everything, 1)
    links.fit_interference(likelihood, mixture, state, everything)
    alike = RandomValues(share=np.zeros(36), below=np.zeros(36), density=np.ones(36))
    memory_gain(likelihood, likelihood.scores(state, everything, 1), mixture, everything, 0.5)
    predicted_noise(np.zeros((_FRAMES, 36)), 0.5, np.ones(36), alike)
