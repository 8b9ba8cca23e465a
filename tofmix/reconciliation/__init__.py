"""Where a simulation and a recording disagree, and which effects explain it.

`workflow` runs the path compare -> localise -> search -> verify. `comparison` has `compare` and `localise`; `one` the
search, with the score of a set of effects; `verification` has `verify`. All of them use the likelihood of `likelihood`,
and the numbers and standard errors of `parameters`. `settings` has the options, `found` the outcome of the search
and the sets of effects that it weighs, `verdict` the verdict.
"""
