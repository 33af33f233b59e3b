"""Mutation testing: which changes, which tests, what came of them."""
