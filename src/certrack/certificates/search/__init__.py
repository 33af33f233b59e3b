"""Searches in floats for what exact arithmetic is then asked to prove: none of it is proven."""
