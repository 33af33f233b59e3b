"""Loops with a sampled controller: one run, which is a run of one member, or many side by side.

A loop's members are described by :class:`~certrack.integrators.sampled.run.SampledProblem`.

* ``events.py`` - when something happens: samples, commands that begin to act, breaks;
* ``maps.py`` - what a sample and what a step between two events computes, by heyoka or NumPy;
* ``scalar_maps.py`` - the same for one member in plain Python numbers, where heyoka is missing;
* ``run.py`` - from event to event by these maps;
* ``native.py`` - the same in C (``native.c``), for many members;
* ``single.py`` - the same in C (``single.c``), for one run with all its steps;
* ``solution.py`` - what a run leaves, and its solution between the steps.
"""
