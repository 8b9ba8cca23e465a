"""Where a recording and a model disagree: statistics of the normal scores, each against an axis."""
