"""The controller for other tools: each module writes one kind of file from the same description."""
