"""Integrators: closed loops in, trajectories or the statistics' raw numbers out.

* ``base`` - what an integrator of one run takes and returns, and the duties of its author
  (:class:`~certrack.integrators.base.Integrator`);
* ``single`` - one run at a time, as a trajectory with dense output: heyoka's Taylor method, SciPy's
  explicit and implicit methods;
* ``many`` - many runs of one system side by side, of which only totals and the values on a grid are
  kept; and the sampled loop, whose single run is a run of one member;
* ``pairs`` - the coefficients of the Runge-Kutta methods.
"""
