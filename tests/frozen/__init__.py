"""Results of the commands on fixed inputs, held against those of an earlier commit: `python -m frozen REV`."""
