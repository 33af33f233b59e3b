"""Motion profiles: moves from rest to rest, sweeps and sums of sines, pieces by coefficients.

A move list (:mod:`~certrack.references.profiles.moves`) is made of phases in which one derivative
is constant: the shortest under limits (:mod:`~certrack.references.profiles.shortest`), or of one
polynomial a move (:mod:`~certrack.references.profiles.polynomial`).
"""
