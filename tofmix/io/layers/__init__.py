"""Layers files (`*.layers.h5`): their chunks, the journal of an unfinished run, and their provenance."""
