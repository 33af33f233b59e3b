"""The plant, its uncertainty, the true plant, what varies between members, and the drive."""
