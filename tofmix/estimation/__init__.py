"""Recording -> density -> modes -> mixture -> counting -> layers.

`peaks` is the paper's step 1 and `mixture` its step 2. `mixture.counting` decides which surfaces remain,
`mixture.uncertainty` gives their standard errors. `layering` runs all of it over pixels, and `blocks.sequence` runs
`layering` over a recording in parallel blocks. `noise` measures sigma(r) and p(c_r) from a recording; `learnt` learns
noise that sigma(r) does not describe. `settings` holds the options that all share.
"""
