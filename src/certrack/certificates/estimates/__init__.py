"""Bounds in floats, with their gradients in the data of the loop: for searches, never as proven."""
