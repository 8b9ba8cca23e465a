"""Surfaces in each pixel of a scene: by beams for recordings, by exact areas for predictions."""
