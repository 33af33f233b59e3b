"""Many runs at once: all members of one continuous closed loop side by side.

A loop is described by :class:`~certrack.integrators.many.augmented.AugmentedFlow`.

* ``native.py`` - C written for the system (``native_source.py``) around ``native.c``, compiled
  where it runs: members in the lanes of vector registers, by explicit steps
  (``explicit_step.h``) or linearly implicit ones (``implicit_step.h``, ``implicit_source.py``);
* ``lockstep.py`` - one Runge-Kutta step compiled by heyoka (``lockstep_map.py``), on a time
  grid that all members share;
* ``taylor_batch.py`` - eight lanes of heyoka's Taylor integrator, for the search of the worst case;
* ``numpy_batch.py`` - the same search in NumPy, where heyoka is missing.
"""
