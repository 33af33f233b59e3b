"""Certificates for ranges of named constants: the loop as a function of them, and its hulls."""
