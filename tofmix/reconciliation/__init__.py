"""Where a simulation and a recording disagree, and which effect explains it.

`workflow` runs the path compare -> localise -> name -> add -> verify. Its modules lie in five folders: `comparison` has
`compare` and `localise`, `search` has `name` and `add`, `verification` has `verify`. All of them use the likelihood of
`likelihood`, and the searches and standard errors of `parameters`. `one` is the search; with ``TOFMIX_SEARCH=old``, `name`
and `add` take its place. `ledger` has the sets of effects that either weighs.
"""
