"""Integrators: each turns a closed loop into a trajectory with dense output."""
