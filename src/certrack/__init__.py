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
        "laws.backstepping": ["ErrorCoordinates", "Gains", "recursion"],
        "certificates": ["Certificates", "NoCertificate", "certify", "tube", "verify"],
        "studies.ensembles.ensemble": ["Ensemble", "ensemble"],
        "export.python_control": ["to_control"],
        "core.errors": ["CertrackError", "DesignError", "InputError", "MissingExtra"],
        "certificates.assumption_1": ["check_assumption_1"],
        "model.implementation": ["Implementation"],
        "integrators.base": ["Outcome"],
        "laws": ["Adaptive", "Classic", "Law", "Robust"],
        "core.latex": ["latex_table"],
        "studies.ensembles.comparison": ["PairedComparison", "paired"],
        "studies.margins": ["margins"],
        "simulation.metrics": ["Metrics"],
        "model.plant": ["Plant"],
        "model.uncertainty": ["Uncertainty"],
        "model.distribution": ["Distribution"],
        "model.population": ["Population"],
        "references": [
            "SymbolicReference",
            "samples",
            "steps",
            "trapezoid",
            "triangle",
        ],
        "simulation.run": ["Run"],
        "simulation.simulator": ["Simulator", "simulate"],
        "systems.system": ["Settings", "System"],
        "systems.reader": ["catalog", "load", "loads"],
        "systems.writer": ["save", "to_text"],
        "model.truth": ["Truth"],
    },
)
