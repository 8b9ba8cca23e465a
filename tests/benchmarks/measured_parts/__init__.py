"""The parts of `measured.py`, a module each."""
