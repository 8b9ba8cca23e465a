"""A file in numbers and words: the summary, its tables, its findings, and descriptions for `tofmix info`."""
