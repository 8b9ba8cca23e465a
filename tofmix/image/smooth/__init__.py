"""Smooth surfaces, of which planes are the special case: an image's ranges and light -> segments -> patches.

`segments` links the pixels of one surface, `patch` fits a piece of constant curvature to the pixels around a place,
`scales` learns how much a surface bends, and `light` adds what its brightness tells of its slope.
"""
