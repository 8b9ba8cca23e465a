"""A recording in blocks: which part is read when, and which thread estimates it."""
