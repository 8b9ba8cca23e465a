"""tofmix from Python: the names of `import tofmix`.

Use these functions in scripts and notebooks. They are `tofmix.open`, `tofmix.from_array`, `tofmix.estimate`,
`tofmix.simulate`, `tofmix.reconcile` and `tofmix.plot`, loaded when they are first used. The command line does not use
this package. For samples that do not fit into memory use `tofmix estimate`, or the functions below these:
docs/how-to/python.md.
"""
