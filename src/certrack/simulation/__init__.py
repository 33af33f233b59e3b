"""One run of a system: choose a method, integrate, measure."""
