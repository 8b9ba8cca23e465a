"""Surfaces: which layers of neighbouring pixels are of one surface, its plane, and its edges below a pixel."""
