"""Plant and law connected, as formulas: in continuous time, and sampled as on a drive."""
