"""One score and one search for sets of effects; with ``TOFMIX_SEARCH=old``, `search/` is taken.

In the order of the data: `static_errors` (the errors of pixels that are integrated out), `coordinates` (an effect as a
vector with a prior), `unnamed` (smooth laws without a name), `recordings` (what all sets share), `steps_kernel` (exact
likelihood of quantised samples), `fitted_set` (a set at its most likely numbers, with its score), `proposals` (the
linear evidence of all sets), `search` (which sets are fitted), `outcome` (the best set as the verdict needs it).
"""
