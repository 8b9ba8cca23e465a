"""Effects that no registry of the package has: each shows, in a file of its own, all that a kind needs."""
