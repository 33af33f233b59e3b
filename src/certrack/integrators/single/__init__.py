"""One run at a time: the Taylor method, SciPy, and the kinks on the way."""
