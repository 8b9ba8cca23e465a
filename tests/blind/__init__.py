"""The blind bench: recordings with a hidden effect, from a camera simulator that shares no code with the package."""
