"""Jobs: what a command and its Python function both do, with all checks, warnings and notes, and no printing."""
