"""What was found is held against rivals without a name and new simulations, and followed by advice."""
