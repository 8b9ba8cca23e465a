"""Surfaces: which layers of neighbouring pixels are of one surface, its plane or smooth fit, its edges below a pixel.

The data's path: layers -> `nodes` (inverse ranges and their errors) -> `linking` (planes grown from node to node by
`growing`) -> `smooth_linking` (what bends is one smooth surface: `smooth_pieces`) -> `smooth_fits` and `shapes` (where
surfaces lie in their pixels) -> `shares` (the surfaces of each pixel, near to far) -> `cuts` (where a surface ends in a
pixel) -> `edge_fit` (lines, arcs and bars through runs of shares: `edge_pixels` around a cut, `edge_shape` and
`half_plane` for areas, `edge_run` for the numbers) -> `run_errors` (errors that a run has in common) -> `regions` (what
a surface covers in its pixel, corners included) -> `grazing` (edges go on where nothing was noticed) -> `painting` (the
fine range image) and `edge_lines`. `reconstruct` is the entry, `found` the outcome. `rectangles` makes
flat rectangles of planes, for models.
"""
