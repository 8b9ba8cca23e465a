"""Checks of finished files: every chunk is read and every rule of the format is applied."""
