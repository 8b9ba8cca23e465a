"""The parts of `not_there.py`, a module each."""
