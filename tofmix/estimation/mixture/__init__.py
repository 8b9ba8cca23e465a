"""Step 2 of the paper: equation (1) fitted to a pixel, the number of its surfaces, and their standard errors."""
