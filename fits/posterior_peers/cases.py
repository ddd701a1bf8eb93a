"""Synthetic data sets of known truth, like those of ``synthetic_recovery``.

The slip is known exactly: tirefit integrates slip noise out, whereas a model in NumPyro
would sample the true slip, one latent number per row.
"""

from typing import NamedTuple

import numpy as np

from fits import formulas
from fits.synthetic_recovery.make_data import FZ, TRUTH, largest_slip
from tirefit.data.table import TireData

__all__ = ["CASES", "Case", "synthetic"]

ROWS = 200
NOISE = 0.01
"""Standard deviation of the force over the load: the rig of ``synthetic_recovery``."""


class Case(NamedTuple):
    """A model with its true parameters and the largest measured physical slip."""

    model: str
    truth: dict[str, float]
    largest: float
    words: str


_BRUSH = TRUTH["brush"][1]
_MAGIC = {"B": 10.0, "C": 1.6, "D": 0.9, "E": -0.5}

CASES = {
    "brush": Case("brush", _BRUSH, 0.3, "brush, to full sliding"),
    "brush-low": Case(
        "brush",
        _BRUSH,
        largest_slip(0.6, _BRUSH["cpa2"], _BRUSH["mu"], FZ.min()),
        "brush, 60 % of the friction used",
    ),
    "magic-formula": Case("magic-formula", _MAGIC, 0.3, "Magic Formula, past the peak"),
}


def synthetic(case: Case, seed: int) -> TireData:
    """200 rows by fits/formulas.py: uniform slips from 0.001, three loads in turn."""
    generator = np.random.default_rng(seed)
    sigma = generator.uniform(0.001, case.largest, ROWS)
    fz = FZ[np.arange(ROWS) % len(FZ)]
    if case.model == "brush":
        force = formulas.brush(sigma, fz, 0.0, *case.truth.values())
    else:
        force = formulas.magic_formula(sigma / (1 + sigma), fz, **case.truth)
    force = force + NOISE * fz * generator.standard_normal(ROWS)
    return TireData(
        "synthetic",
        {"sigma_x": sigma, "fx": force, "fz": fz},
        np.ones(ROWS, bool),
        np.zeros(ROWS, int),
        ("r",),
    )
