"""Layers that the samples show and the scene may not have: scattered, folded, passing and near returns.

Each suspicion is a file with one declaration, and its line in `registry`. `evidence` gathers from the samples, pixel by
pixel, what a layers file does not keep; `judge` applies all suspicions to a window, when all its pixels are known.
Layers stay as they are: a mark is a flag beside them.
"""
