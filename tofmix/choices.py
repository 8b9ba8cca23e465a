"""Names that options of the public functions take, for type checkers: ``sigma="tide"`` is an error before it runs.

The lists that the program checks itself stand where they are used; `tests/api/test_typing.py` holds both together.
"""

from typing import Literal

Sigma = Literal["tied", "prior", "free"]
Refine = Literal["likelihood", "none"]
Mixing = Literal["auto", "events", "phasor"]
Shape = Literal["gaussian", "auto"]
Widths = Literal["common", "own", "auto"]
Units = Literal["mm", "cm", "m"]
DepthAxis = Literal["ray", "z"]
Split = Literal["frames,pixels", "frames", "pixels"]
