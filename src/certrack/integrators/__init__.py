"""Integrators: closed loops in, trajectories or the statistics' raw numbers out.

* ``base`` - what an integrator of one run takes and returns, and the duties of its author
  (:class:`~certrack.integrators.base.Integrator`);
* ``single`` - one run of a continuous loop, as a trajectory with dense output: heyoka's Taylor
  method, SciPy's explicit and implicit methods;
* ``many`` - many runs of a continuous loop side by side, of which only totals and the values on a
  grid are kept;
* ``sampled`` - one run or many of a loop with a sampled controller, from event to event;
* ``peaks`` - the largest |e_1| of many runs, each lane of a register with steps of its own;
* ``pairs``, ``rosenbrock`` - the coefficients of the Runge-Kutta methods, and of the linearly
  implicit one for stiff systems;
* ``registers`` - how many members fill a vector register; ``vector_math.h`` is the arithmetic of
  registers in the C files, ``scalar_math.h`` that of one run.
"""
