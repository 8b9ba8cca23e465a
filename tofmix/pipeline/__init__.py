"""From a recording to a layers file, on one machine or several: connects the estimator and the files."""
