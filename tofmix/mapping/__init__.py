"""Occupancy maps from layers: beams -> kernel (light that stops, light that passes) -> log-odds -> map.

It knows no files: `tofmix.io.map_file` and `tofmix.io.map_file` write the results.
"""
