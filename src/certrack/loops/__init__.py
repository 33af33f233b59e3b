"""The closed loop as formulas: the simulated plant, the controller and the reference joined.

Nothing is integrated here; what is compiled and run from these formulas has rooms of its own. To
be read in this order:

``plant``
    The simulated plant x' = f(t, x, u), before any controller.
``continuous``
    The closed loop in continuous time: plant, law and reference as one differential equation.
``controller``
    The controller in discrete time, as it runs every period on a drive.
``sampled``
    The closed loop with that controller: what happens at and between the samples.
``time_switches``
    Switches of time, taken out of the formulas of both loops.
``bursts``
    Where smooth formulas of time suddenly move fast.
``schedule``
    When a run has to stop and restart: breaks of the reference, switches, bursts.
``stability``
    The exact edge of stability of a linear sampled loop.
"""
