"""Surfaces across the pixels of an image: what unmixing and the search for edges have in common."""
