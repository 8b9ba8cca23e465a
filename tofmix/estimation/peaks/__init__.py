"""Step 1 of the paper: the density of a pixel's samples, and its peaks."""
