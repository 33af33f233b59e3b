"""One run at a time: the Taylor method, SciPy's, and switches for kinks of the state."""
