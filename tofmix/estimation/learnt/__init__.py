"""Layers of pixels under learnt noise: errors of any shape, and a width, background and drift of each pixel.

`model` describes the noise, `learning` learns it, and `bootstrap` draws the gains of noise alone. `em`, `trials` and
`counting` are the kernels, and `blocks` makes layers with them.
"""
