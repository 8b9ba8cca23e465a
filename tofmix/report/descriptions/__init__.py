"""Descriptions of files for `tofmix info`: one module a kind of file; description: what they have in common."""
