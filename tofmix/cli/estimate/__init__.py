"""``tofmix estimate``: command (the options) -> request -> outputs, noise -> runs -> results."""
