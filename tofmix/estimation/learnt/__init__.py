"""Layers of pixels whose noise is learnt: any shape, widths, backgrounds and drifts of their own.

`model` says what is learnt, `learning` learns it, `thresholds` calibrates the count, `fitting` and `counting` are the
kernels, `blocks` makes layers with them.
"""
