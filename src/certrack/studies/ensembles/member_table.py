"""The metrics of every single member: what a paired comparison and a data frame are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

#: Ensembles of up to so many members keep the metrics of each, by default; 65 bytes a member.
KEPT_MEMBERS = 100_000

#: First member, metrics (M, N) and numbers of the outcomes (N,).
TablePart = tuple[int, np.ndarray, np.ndarray]


@dataclass
class MemberTable:
    """Metrics and outcomes of members, in parts that need not be in order.

    Attributes
    ----------
    parts : list
        First member, metrics (M, N), NaN for a member that did not finish, and outcomes (N,) by
        their numbers.
    """

    parts: list[TablePart] = field(default_factory=list)

    def add(self, begin: int, metrics: np.ndarray, outcomes: np.ndarray) -> None:
        """Members begin, begin + 1, ..."""
        self.parts.append((begin, np.array(metrics), outcomes.astype(np.int8)))

    def merge(self, other: MemberTable) -> None:
        """Add other members."""
        self.parts += other.parts

    def arrays(self, members: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Metrics (M, members) and outcomes (members,) of the first members; None if not all."""
        ordered = sorted(self.parts, key=lambda part: part[0])
        expected = 0
        for begin, _, outcomes in ordered:
            if begin != expected:
                return None
            expected += len(outcomes)
        if expected != members or not ordered:
            return None
        metrics = np.concatenate([metrics for _, metrics, _ in ordered], axis=1)
        return metrics, np.concatenate([outcomes for *_, outcomes in ordered])

    def packed(self) -> dict[str, np.ndarray]:
        """Arrays for a file or a network: the same for the same members, whatever the parts."""
        ordered = sorted(self.parts, key=lambda part: part[0])
        sizes: list[list[int]] = []
        for begin, _, codes in ordered:
            if sizes and sum(sizes[-1]) == begin:
                sizes[-1][1] += len(codes)
            else:
                sizes.append([begin, len(codes)])
        metrics = [metrics for _, metrics, _ in ordered]
        outcomes = [outcomes for *_, outcomes in ordered]
        return {
            "table_parts": np.array(sizes, dtype=np.int64).reshape(-1, 2),
            "table_metrics": np.concatenate(metrics, axis=1) if metrics else np.empty((0, 0)),
            "table_outcomes": np.concatenate(outcomes) if outcomes else np.empty(0, np.int8),
        }

    def add_packed(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Merge what :meth:`packed` gave."""
        metrics, outcomes, place = arrays["table_metrics"], arrays["table_outcomes"], 0
        for begin, count in arrays["table_parts"].tolist():
            part = slice(place, place + count)
            self.add(begin, metrics[:, part], outcomes[part])
            place += count
