"""``python -m fuzz [KIND] [--count N] [--seed N]`` in the folder tests; see ``make fuzz``."""

import argparse
import sys
import warnings
from pathlib import Path

from fuzz import KINDS, fuzzer
from fuzz.runner import run

#: Inputs of a full run.
COUNTS = {
    "systems": 20_000,
    "expressions": 200_000,
    "certificates": 20_000,
    "samples": 20_000,
    "chunks": 5_000,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--count", type=int, help="inputs of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("build/fuzz"), help="for what is found")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    found = 0
    for kind in options.kinds or KINDS:
        report = run(fuzzer(kind), options.seed, options.count or COUNTS[kind], options.keep)
        print(f"{kind}, seed {options.seed}: {report}", flush=True)
        found += len(report.findings)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
