"""Outputs that appear whole or not at all: temporary files, locks, groups of files, folders for partial outputs."""
