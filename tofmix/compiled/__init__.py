"""How kernels are compiled, and the small kernels and numbers that kernels of several folders use."""
