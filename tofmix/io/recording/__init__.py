"""Recordings (`*.h5`): reading, writing, and the checks of their ranges."""
