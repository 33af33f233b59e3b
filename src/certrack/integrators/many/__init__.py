"""Many runs at once, all members of one system side by side.

Continuous loops, described by :class:`~certrack.integrators.many.augmented.AugmentedFlow`:

* ``native.py`` - C written for the system (``native_source.py``) around ``native.c``, compiled
  where it runs: members in the lanes of vector registers;
* ``lockstep.py`` - one Runge-Kutta step compiled by heyoka (``lockstep_map.py``), on a time
  grid that all members share;
* ``taylor_batch.py`` - eight lanes of heyoka's Taylor integrator, for the search of the worst case.

Loops with a sampled controller, described by
:class:`~certrack.integrators.many.sampled_run.SampledProblem`:

* ``sampled_events.py`` - when something happens: samples, commands that begin to act, breaks;
* ``sampled_run.py`` - from event to event in NumPy, with the maps of ``sampled_maps.py`` (heyoka or
  NumPy); a single run is a run of one member;
* ``sampled_native.py`` - the same in C (``sampled_native.c``).

``vector_math.h`` is the arithmetic of both C files, ``registers.py`` how many members fill a
register, ``certrack.integrators.pairs`` the tables of the Runge-Kutta methods.
"""
