"""How likely a recording is under a model with effects: the mixture of each sample, and what links samples."""
