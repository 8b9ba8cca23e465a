"""Processes with an environment of their own, and the measuring of coverage."""

import os


def coverage_environment() -> dict[str, str]:
    """What coverage needs in a process's environment to follow there; nothing where it is not measured."""
    return {name: value for name, value in os.environ.items() if name.startswith("COVERAGE_")}
