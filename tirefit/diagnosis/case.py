"""Everything known of one file when its verdict stands."""

from dataclasses import dataclass

import numpy as np

from tirefit.diagnosis.base import Base
from tirefit.diagnosis.search import Hypothesis, Search
from tirefit.diagnosis.verdict import Verdict, Weighed

__all__ = ["Case", "amplitudes_of"]


@dataclass(frozen=True)
class Case:
    """Everything known of one file when its verdict stands."""

    base: Base
    search: Search
    weighed: Weighed
    verdict: Verdict
    untestable: list[dict]


def amplitudes_of(base: Base, hypothesis: Hypothesis) -> np.ndarray:
    """Amplitudes of all atoms (K,) in their own units."""
    full = np.zeros(len(base.atoms))
    scale = np.asarray(base.design.prior_scale)
    for k, a in zip(hypothesis.atoms, hypothesis.amplitude, strict=True):
        full[k] += a * scale[k]
    return full
