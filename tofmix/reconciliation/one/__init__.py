"""One score and one search for sets of effects.

In the order of the data: `static_errors` (errors of pixels that are integrated out), `columns` (changes by small
effects), `coordinates` (an effect as a vector with a prior; smooth laws without a name), `scene_errors` (errors of what
the model knows of its scene), `recordings` (what all sets share; biases in time, and what a memory of the noise leaves
of them), `steps_kernel` (exact likelihood of quantised samples), `expansion` (the samples with static errors integrated
out), `summary` (what proposals need of the samples), `fitted_set` (a set at its most likely numbers, with its score),
`proposals` (the linear evidence of all sets), `search` (which sets are fitted), `outcome` (the best set as the verdict
needs it).
"""
