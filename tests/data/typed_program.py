"""A user's program, as mypy reads it; tests/test_public_face.py says what it must find."""

from typing import reveal_type

import certrack

system = certrack.load("x")
reveal_type(system)
reveal_type(certrack.simulate(system))
reveal_type(certrack.simulate(system).metrics.settling_time)
reveal_type(certrack.certify(system).best.bound)
reveal_type(certrack.ensemble(system, 10).members)
reveal_type(certrack.margins(system))
reveal_type(certrack.falsify(system).worst_error)
reveal_type(system.design())
reveal_type(certrack.export_st(system, "drive.st"))
reveal_type(certrack.plot(system))
reveal_type(certrack.reproduce().claims)
reveal_type(certrack.certificates.verify("cert.json"))
reveal_type(certrack.references.steps((1.0,), (0.0, 1.0), 0.5))
reveal_type(certrack.__version__)


def show(done: float, total: float | None, best: float | None) -> None:
    print(done, total, best)


certrack.ensemble(system, progress=show)
certrack.ensemble(system, progress=certrack.Cancellable(show))
certrack.ensemble(system, progress=lambda done: None)  # error: another convention
print(certrack.no_such_name)  # error
certrack.simulate("example1")  # error: a name is no system
