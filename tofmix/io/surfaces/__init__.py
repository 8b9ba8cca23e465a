"""Surfaces files (`*.surfaces.h5`), the result of `tofmix surfaces`: fields -> surfaces_writer and surfaces_file."""
