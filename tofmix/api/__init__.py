"""tofmix from Python, in a few lines: what `import tofmix` offers.

Use these functions in scripts and notebooks. They are `tofmix.open`, `tofmix.from_array`, `tofmix.estimate`,
`tofmix.simulate`, `tofmix.reconcile` and `tofmix.plot`, loaded when they are first used. The command line does not come
through here. For samples that do not fit into memory use `tofmix estimate`, or the functions below these:
docs/how-to/python.md.
"""
