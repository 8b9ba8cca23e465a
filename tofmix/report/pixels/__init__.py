"""Single pixels: their samples, layers and density, as numbers, tables and figures."""
