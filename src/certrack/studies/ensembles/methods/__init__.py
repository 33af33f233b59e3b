"""The ways of computing the members of an ensemble: one interface, one file per way."""
