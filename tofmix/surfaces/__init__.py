"""Surfaces: which layers of neighbouring pixels are of one surface, its plane or smooth fit, its edges below a pixel.

The data's path: layers -> `nodes` (inverse ranges and their errors) -> `linking` (planes grown from node to node) ->
`smooth_linking` (what bends is one smooth surface) -> `smooth_fits` (where surfaces lie in their pixels) -> `shares`
and `areas` (the surfaces of each pixel, near to far) -> `edge_fit` (lines, arcs and bars through runs of shares:
`edge_shape` for areas, `edge_run` for the numbers) -> `regions` (what a surface covers in its pixel, corners included)
-> `painting` (edges go on where nothing was noticed; the fine range image) and `edge_lines`.
`reconstruct` is the entry, `found` the outcome. `rectangles` makes flat rectangles of planes, for models.
"""
