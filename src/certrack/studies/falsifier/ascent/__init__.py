"""Ascent: controls of a nonlinear loop that are made worse step by step, by its adjoint."""
