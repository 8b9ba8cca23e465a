"""From a recording to a layers file: the link between the estimator and the files, on one machine or many."""
