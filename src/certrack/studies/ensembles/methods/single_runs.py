"""Every member by itself, by the ordinary simulation: slow, and possible everywhere."""

from __future__ import annotations

import numpy as np

from certrack.studies.ensembles.methods.base import MemberResults, Method
from certrack.studies.ensembles.plan import METRICS
from certrack.studies.ensembles.statistics import Bands


class SingleRuns(Method):
    """Computes no member together with others: all have to be run alone."""

    def compute(self, begin: int, end: int, bands: Bands) -> MemberResults:
        count = end - begin
        metrics = np.full((len(METRICS), count), np.nan)
        return MemberResults(metrics, np.full(count, -1.0), np.ones(count, dtype=bool))
