"""From a recording to a layers file: what brings the estimator and the files together, on one machine or many."""
