"""Where a simulation and a recording disagree, and which effect explains it.

The five steps are five modules: `compare`, `localise`, `name`, `add`, `verify`; `workflow` runs them. All of them use
the likelihood in `kernel`, `mixture` and `likelihood`; the latent states are in `bursts` and `pixel_pattern`. `joint`
makes one likelihood of several recordings of a camera. `side_information` adds amplitudes and temperatures.
"""
