"""Surfaces files (`*.surfaces.h5`), the result of `tofmix surfaces`."""
