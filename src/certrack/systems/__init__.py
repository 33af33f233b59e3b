"""A complete tracking problem, and its file: reading, writing, formulas, the shipped systems."""
