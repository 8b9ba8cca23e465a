"""A layers file in numbers and words: the summary, its tables, its findings."""
