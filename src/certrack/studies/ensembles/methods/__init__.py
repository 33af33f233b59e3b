"""The methods of computing the members of an ensemble: one interface, one file per method."""
