"""certrack: certified tracking control for uncertain nonlinear systems.

>>> import certrack
>>> system = certrack.load("example1")
>>> run = certrack.simulate(system)
>>> round(run.metrics.settling_time, 2)
2.15
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach(
    __name__,
    submod_attrs={
        "backstepping": ["ErrorCoordinates", "Gains", "recursion"],
        "certificates": ["Certificates", "NoCertificate", "certify", "tube", "verify"],
        "ensembles.ensemble": ["Ensemble", "ensemble"],
        "export.control": ["to_control"],
        "errors": ["CertrackError", "DesignError", "InputError", "MissingExtra"],
        "assumption": ["check_assumption_1"],
        "implementation": ["Implementation"],
        "integrators.base": ["Outcome"],
        "laws": ["Adaptive", "Classic", "Law", "Robust"],
        "margin": ["margins"],
        "metrics": ["Metrics"],
        "plant": ["Plant", "Uncertainty"],
        "population": ["Distribution", "Population"],
        "references": [
            "SymbolicReference",
            "samples",
            "steps",
            "trapezoid",
            "triangle",
        ],
        "run": ["Run"],
        "simulation": ["Simulator", "simulate"],
        "system": ["Settings", "System"],
        "systemfile": ["catalog", "load", "loads"],
        "systemtext": ["save", "to_text"],
        "truth": ["Truth"],
    },
)
