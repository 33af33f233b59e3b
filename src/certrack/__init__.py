"""certrack: certified tracking control for uncertain nonlinear systems."""
