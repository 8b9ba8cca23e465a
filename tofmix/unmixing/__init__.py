"""Unmixing: the surfaces in a lock-in camera's mixed pixel, from its mean phasor and its neighbours.

A lock-in camera's pixel that sees several surfaces returns one phasor sum, z = sum_i w_i A_i exp(i r_i / K): its
samples have one mode, at a range without a surface. The surfaces are found in the pixel's amplitude and in its
neighbours.

The data's path: samples -> `image` (mean and covariance of each pixel, the measurements of one window, surfaces
beyond the fold of a folded axis: `unmix.unfolded`) -> `seeds` (pixels that certainly see one surface), `lines`
(narrow surfaces, of one column or row of pixels) -> `neighbours` (the surfaces beside a pixel, continued to it, and
planes of large surfaces) -> `hypotheses` (one surface; `chords`: two, three; `likeliest`: the one to keep) ->
`labels` (rounds over all pixels) -> `unmix` (are the samples phasor sums at all? and the layers).
"""
