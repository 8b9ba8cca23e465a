"""tofmix: the surfaces in a time-of-flight pixel.

A pixel of a time-of-flight camera is a cone. tofmix treats the samples of each
pixel of a recorded sequence as a Gaussian mixture and recovers all surfaces in
it: how many, how far, what share of the beam, how sure.

The data's path through the package:

recording -> `tofmix.estimation` (density -> modes -> mixture -> layers) -> layers file -> `tofmix.report`
scene -> `tofmix.simulation` (scene -> cast -> events -> render) -> recording

`tofmix.io` reads and writes the files, `tofmix.cli` is the command line.
Nothing heavy is imported here, so that ``tofmix --help`` answers at once.
"""

__version__ = "0.1.0"
