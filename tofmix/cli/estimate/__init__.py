"""``tofmix estimate``: command (the options) -> runs -> results."""
