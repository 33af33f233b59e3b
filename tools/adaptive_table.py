"""Certified and found errors of random adaptive plants, side by side.

    python tools/adaptive_table.py                     all of them
    python tools/adaptive_table.py --seeds 3 17        two of them
    python tools/adaptive_table.py --rows FILE         rows as they come; those there are kept

The plants are those of tests/adaptive_plants.py: orders 1 to 4, up to three unknown parameters,
ranges, full Gamma, any feed-forward. `found` is that of `certrack falsify` with its default budget.
A ratio below 1 would be an error of certrack.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from adaptive_plants import random_plant  # type: ignore[import-not-found]

from certrack.studies.falsifier.falsify import falsify

#: Plants of the table.
COUNT = 40


def row_of(seed: int) -> dict[str, Any]:
    """Numbers of one plant."""
    begin, system = time.process_time(), random_plant(seed)
    found = falsify(system)
    plant, against = system.plant, found.against
    return {
        "seed": seed,
        "n": plant.n,
        "r": plant.r,
        "q": system.controller.coordinates.q,
        "ranges": plant.input_gain_range is not None,
        "certified": None if against is None else against.bound,
        "by": None if against is None else against.kind,
        "found": found.worst_error,
        "from": found.origin,
        "alarm": found.alarm,
        "left_out": dict(found.left_out),
        "seconds": round(time.process_time() - begin, 1),
    }


def printed(rows: list[dict[str, Any]]) -> str:
    """The table, worst ratio first, and its median."""
    for row in rows:
        row["ratio"] = row["certified"] / row["found"] if row["certified"] else float("inf")
    names = ("seed", "n", "r", "q", "ranges", "certified", "by", "found", "ratio")
    lines = ["| " + " | ".join(names) + " |", "|--:|--:|--:|--:|---|--:|---|--:|--:|"]
    for row in sorted(rows, key=lambda row: -row["ratio"]):
        shown = row | {
            "ranges": "yes" if row["ranges"] else "",
            "certified": f"{row['certified']:.5f}" if row["certified"] else "-",
            "by": row["by"] or "-",
            "found": f"{row['found']:.5f}",
            "ratio": f"{row['ratio']:.2f}",
        }
        lines.append("| " + " | ".join(str(shown[name]) for name in names) + " |")
    ratios = sorted(row["ratio"] for row in rows)
    middle = statistics.median(ratios)
    lines += ["", f"median {middle:.3f}, least {ratios[0]:.3f}, largest {ratios[-1]:.3f}"]
    return "\n".join(lines)


def main() -> None:
    """The program."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(COUNT)))
    parser.add_argument("--rows", type=Path)
    arguments = parser.parse_args()
    rows = []
    if arguments.rows and arguments.rows.exists():
        rows = [json.loads(line) for line in arguments.rows.read_text().splitlines()]
    known = {row["seed"] for row in rows}
    for seed in arguments.seeds:
        if seed in known:
            continue
        rows.append(row_of(seed))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
        if arguments.rows:
            arguments.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    print(printed(rows))


if __name__ == "__main__":
    main()
