"""Which number of a world tells best whether it fails."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import mannwhitneyu

from eladapt.worlds.rows import FACTORS

CERTAIN = 0.01  # probability of so much by chance, all factors taken together (Bonferroni)
FEWEST = 3  # failed and good worlds below which nothing is said


class Explanation(NamedTuple):
    """What a factor tells about failures."""

    factor: str  # a column, see `FACTORS`
    larger: bool  # whether failures have more of it
    strength: float  # [0, 1]: 1 where it tells failed from good worlds, 0 where they have alike much of it
    probability: float  # of so much by chance


def explanations(rows: np.ndarray, failed: np.ndarray) -> list[Explanation]:
    """Of all factors that differ between the failed (n,) and the other rows, strongest first.

    By the rank statistic of Mann and Whitney, U / (n_failed n_good) = P(a failed world has more of it than a
    good one); strength = |2 P - 1|. It takes one factor at a time: what only two together do, it does not
    see.
    """
    found = []
    for name in FACTORS:
        values = rows[name]
        known = np.isfinite(values)
        bad, good = values[known & failed], values[known & ~failed]
        if min(len(bad), len(good)) < FEWEST or np.ptp(values[known]) == 0:
            continue
        test = mannwhitneyu(bad, good)
        share = 2 * float(test.statistic) / (len(bad) * len(good)) - 1
        found.append(Explanation(name, share > 0, abs(share), float(test.pvalue)))
    certain = [one for one in found if one.probability * len(FACTORS) < CERTAIN]
    return sorted(certain, key=lambda one: -one.strength)


def unusual(rows: np.ndarray, row: np.void, among: list[Explanation]) -> str:
    """What of a world may explain its failure, in words: the factor of those that explain failures in which
    it stands out most; "" where none does."""
    best, said = 0.0, ""
    for factor, larger, strength, _ in among:
        values = rows[factor]
        known = values[np.isfinite(values)]
        if not np.isfinite(row[factor]) or not len(known):
            continue
        rank = float(np.mean(known < row[factor]))
        extreme = strength * (rank if larger else 1 - rank)
        if extreme > best and extreme > strength / 2:
            best, place = extreme, rank if larger else 1 - rank
            side = "more" if larger else "less"
            said = f"{FACTORS[factor]} {row[factor]:.3g}, {side} than in {place:.0%} of the worlds"
    return said
