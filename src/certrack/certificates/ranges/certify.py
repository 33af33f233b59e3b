"""The certificates of a system whose constants have ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from certrack.certificates.ranges.cells import Cell, halved
from certrack.certificates.ranges.proofs import CellProof, RangeProver
