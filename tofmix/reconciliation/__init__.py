"""Where a simulation and a recording disagree, and which effect explains it.

The five steps are five modules: `compare`, `localise`, `name`, `add`, `verify`;
`workflow` runs them. The likelihood that all of them share is in `kernel`,
`mixture` and `likelihood`; the latent states are in `bursts` and `pixel_pattern`. Several recordings of one camera
are one likelihood: `joint`. What amplitudes and temperatures add is in `witnesses`.
"""
