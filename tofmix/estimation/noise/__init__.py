"""The noise of a recording: sigma(r) and p(c_r) measured from it, and whether a given curve fits it."""
