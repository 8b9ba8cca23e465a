"""Files in and out.

`schema` declares every dataset. Below it: outputs that appear whole or not at all (`storage`), safe reading of files of
unknown origin (`guard`), each kind of file, what is imported and exported, and `verify`.

Errors are one line that names the file, the dataset, the reason and, where there is one, the remedy: `BadInputError`
for an input that is missing, damaged, or of another kind or size than stated; `UsageError` for an option that does not
fit, an output that must not be replaced, or a missing library; `StorageError` where the disk is full or fails. The
docstrings name them only where a caller acts on one.
"""
