"""Which modules are changed together, and which tests are to notice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "certrack"


@dataclass(frozen=True)
class Group:
    """Patterns of modules below ``src/certrack``, and the files of tests, without ``test_``."""

    patterns: str
    tests: str
    texts: bool = False  # whether operators inside texts are changed, too: printers

    @property
    def modules(self) -> list[str]:
        """Paths below ``src/certrack``; packages' own files only gather names."""
        found = {p for pattern in self.patterns.split() for p in SOURCE.glob(pattern + ".py")}
        return sorted(str(p.relative_to(SOURCE)) for p in found if p.name != "__init__.py")

    @property
    def files(self) -> list[str]:
        """Files of tests, relative to the repository."""
        return [f"tests/test_{name}.py" for name in self.tests.split()]


GROUPS = {
    "backstepping": Group(
        "laws/backstepping laws/recursion laws/integral laws/plant_coordinates",
        "backstepping laws testing linear_law",
    ),
    "laws": Group(
        "laws/adaptive laws/balanced laws/base laws/classic laws/error_system laws/leakage"
        " laws/numbers laws/registry laws/robust laws/signals",
        "laws law_formulas law_keys testing backstepping exact_numbers lyapunov extensions",
    ),
    "certificates": Group(
        "certificates/*",
        "certificates certificate_formulas certificate_parts published_formulas certificate_data"
        " certify_parts certificate_layout size_majorants exact_checks rounding bounds peak tube"
        " independent_checker tube_parts error_problem premises truth strength exact_numbers"
        " false_claims forged_claims input_bounds input_parts level_set verdicts",
    ),
    "input-bounds": Group(
        "certificates/input_* certificates/mean_squares", "input_bounds input_parts"
    ),
    "online": Group("certificates/online/* laws/online", "online online_parts seeking"),
    "bootstrap": Group(
        "certificates/bootstrap/*", "bootstrap polynomials bootstrap_parts certificate_layout"
    ),
    "ranges": Group(
        "certificates/ranges/*",
        "range_algebra range_parts kernel_parts prover_parts attainable ranges independent_ranges"
        " sectors strength peak estimates range_tubes exact_checks",
    ),
    "implemented": Group(
        "certificates/implemented/*",
        "implemented implemented_formulas implemented_parts implemented_start enclosed"
        " range_algebra forged_claims regional jitter proven_box implemented_ranges slow"
        " slow_signals slow_parts slow_split fixed_point_parts implemented_conditions start_parts"
        " certificate_layout regional_parts",
    ),
    "references": Group(
        "references/*",
        "references reference_parts reference_keys reference_members growth taylor bound_search"
        " testing bounds premises simulation time_events units lipschitz soft_start samples_file"
        " moves profiles extremes",
    ),
    "metrics": Group("simulation/metrics simulation/refine", "metrics refine simulation"),
    "sampled": Group(
        "loops/controller loops/sampled integrators/sampled/run",
        "controller sampled_steps sampled sliding",
    ),
    "statistics": Group("studies/ensembles/statistics", "statistics"),
    "c-printers": Group(
        "export/c/export export/c/guard export/c/printer export/c/source core/printing",
        "printing monitor_text c_text export_c guard words",
        texts=True,
    ),
    "monitor": Group("export/monitor* export/*/monitor*", "monitor_text monitor_probes monitor"),
}
