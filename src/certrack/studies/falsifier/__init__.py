"""The search of the worst admissible case of a system."""
