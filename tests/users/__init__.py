"""Scenes that users have: cases drawn from a seed, what can be known of them, and how `reconcile` is scored on them."""
