"""The best possible trajectory of a plant, and how far the laws are from it."""
