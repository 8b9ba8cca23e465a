"""Jobs: what a command and its Python function both do, with all checks, warnings and notes, and no printing.

A job raises `tofmix.jobs.reporter.OptionError` for its options, `tofmix.errors.BadInputError` for what it reads,
`UsageError` for outputs that exist, and `StorageError` for outputs that cannot be written.
"""
