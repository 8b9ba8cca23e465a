"""Faults made on purpose: hostile files, failing system calls, killed processes, load.

`python -m faults.long` (with `tests` on the path) runs all of it; a small fixed part of each is a test of the suite.
"""
