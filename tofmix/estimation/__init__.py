"""Recording -> density -> modes -> mixture -> counting -> layers.

One module a step: `density` and `modes` are the paper's step 1, `mixture` its
step 2, `counting` decides which surfaces stand, `uncertainty` gives their
standard errors, `layering` runs all of it over pixels, and `sequence` runs
`layering` over a recording in parallel blocks. `settings` holds what they share.
"""
