"""The page of a reconciliation: statistics of recording and model side by side."""
