"""Questions that take many runs: ensembles, margins of the implementation, the falsifier."""
