"""Probability against observed share: the reliability diagram and its table."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from scipy.stats import beta

__all__ = ["Bin", "draw_reliability", "reliability"]

BINS = 10
LEVEL = 0.9  # of the error bars


class Bin(NamedTuple):
    """One tenth of the probability: mean probability, share right with its interval."""

    probability: float
    right: float
    low: float
    high: float
    count: int


def reliability(outcomes: Sequence) -> list[Bin]:
    """Tenths with at least one outcome; intervals: binomial (Clopper-Pearson), 90 %."""
    p = np.array([o.probability for o in outcomes], float)
    right = np.array([o.right for o in outcomes], bool)
    place = np.minimum((p * BINS).astype(int), BINS - 1)
    out, tail = [], (1 - LEVEL) / 2
    for k in np.unique(place):
        n, hits = int(np.sum(place == k)), int(np.sum(right[place == k]))
        low = beta.ppf(tail, hits, n - hits + 1) if hits else 0.0
        high = beta.ppf(1 - tail, hits + 1, n - hits) if hits < n else 1.0
        mean = float(p[place == k].mean())
        out.append(Bin(mean, hits / n, float(low), float(high), n))
    return out


def draw_reliability(methods: Mapping[str, Sequence[Bin]], path: Path) -> None:
    """Writes the diagram of one or more methods as PNG; the first has error bars."""
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (above, below) = plt.subplots(
        2, 1, figsize=(5.2, 6.2), sharex=True, height_ratios=[4, 1], layout="constrained"
    )
    above.plot([0, 1], [0, 1], color="0.6", linewidth=1, zorder=0)
    above.annotate("calibrated", (0.02, 0.02), rotation=45, color="0.45",
                   rotation_mode="anchor", transform_rotates_text=True, fontsize=8,
                   xytext=(0, 4), textcoords="offset points")  # fmt: skip
    colours = ["C0", "0.35", "C1", "C2", "C4", "C5"]
    for number, (name, bins) in enumerate(methods.items()):
        colour, x = colours[number % len(colours)], [b.probability for b in bins]
        y = [b.right for b in bins]
        if number:
            above.plot(x, y, color=colour, marker=".", linewidth=0.8, alpha=0.8, label=name)
            continue
        bars = [[b.right - b.low for b in bins], [b.high - b.right for b in bins]]
        above.errorbar(x, y, yerr=bars, color=colour, marker="o", capsize=3, zorder=3, label=name)
        below.bar(x, [b.count for b in bins], width=0.06, color=colour)
        for b in bins:
            below.annotate(
                str(b.count), (b.probability, b.count), ha="center", va="bottom", fontsize=8
            )
    above.set(ylabel="share right (bars: 90 %)", ylim=(-0.03, 1.03))
    below.set(xlabel="probability of the verdict", ylabel="verdicts", xlim=(-0.03, 1.03))
    below.margins(y=0.3)
    handles, names = above.get_legend_handles_labels()
    order = sorted(range(len(names)), key=lambda k: list(methods).index(names[k]))
    figure.legend(
        [handles[k] for k in order],
        [names[k] for k in order],
        loc="outside upper center",
        ncols=3,
        frameon=False,
    )
    figure.savefig(path, dpi=130)
    plt.close(figure)
