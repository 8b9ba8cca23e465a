"""The numbers of effects: where their search starts, how they are fitted, and their standard errors."""
