"""Parts of `not_there.py`: a module for each situation."""
