"""A refitted set of effects, linearised: what it leaves and what it has used up, in
other forms and where the slips are in doubt too."""

from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.evidence.forms import form_columns
from tirefit.diagnosis.evidence.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.negligible import FLAT
from tirefit.diagnosis.rows.basis import gain, gains, orthogonal

PRIOR_OF_FORM = 0.4
"""That a listed effect is there in another form than the formulas'."""


class LinearFit(NamedTuple):
    """A refitted hypothesis: residual (m,), the columns that it used up (m, p), those
    of the other forms of its effects (m, k), and what is measured beside the slip knows
    of its noise (m, j)."""

    residual: np.ndarray
    used_up: np.ndarray
    forms: np.ndarray
    proxies: np.ndarray

    @property
    def explained(self) -> np.ndarray:
        """Columns (m, p + j) of all that needs no further explanation."""
        return np.concatenate([self.used_up, self.proxies], axis=1)

    def in_other_form(self) -> "LinearFit":
        """The same where the effects are there in another form: that is used up too."""
        whole = np.concatenate([self.used_up, self.forms], axis=1)
        return self._replace(used_up=whole)


def linear_at(base, hypothesis: Hypothesis) -> LinearFit:
    """Around a refitted hypothesis."""
    residual, jacobian, columns, fields = base.linearised(
        hypothesis.z, amplitudes_of(base, hypothesis)
    )
    own = columns[:, list(hypothesis.atoms)]
    effects = [base.atoms[k].effect for k in hypothesis.atoms]
    forms = form_columns(effects, fields, base.prepared, base.slip_fraction)
    keep = np.tile(base.design.keep[: base.prepared.n], len(base.prepared.channels))
    return LinearFit(
        residual,
        np.concatenate([jacobian, own], axis=1),
        forms * keep[:, None],
        base.proxies,
    )


def due_to_doubt(base, hypothesis: Hypothesis, linear: LinearFit) -> float:
    """What the doubt of the slips, of which a refit knew nothing, changes in the log
    evidence of a set around its own fit.

    It is not fitted again: sets that miss much end at one optimum or another then, and
    their evidence is a matter of chance by tens of units.
    """
    center = np.asarray(base.design.prior_center)[list(hypothesis.atoms)]
    off = hypothesis.amplitude - center
    p = linear.used_up.shape[1] - len(off)
    prior = np.diag(np.concatenate([np.full(p, FLAT), np.ones(len(off))]))

    def log_evidence(used_up, residual):
        determinant = np.linalg.slogdet(used_up.T @ used_up + prior)[1]
        return -0.5 * (residual @ residual + off @ off + determinant)

    doubted = base.sure(linear.used_up), base.sure(linear.residual)
    return float(log_evidence(*doubted) - log_evidence(linear.used_up, linear.residual))


def gain_of_form(base, linear: LinearFit) -> float:
    """Log evidence of the other forms over the formulas, with their prior."""
    forms, used_up = base.sure(linear.forms), base.sure(linear.used_up)
    left, size = orthogonal(forms, used_up)
    there = gain(left.T @ base.sure(linear.residual), size)
    return there + float(np.log(PRIOR_OF_FORM))


def gains_beside(base, linear: LinearFit, in_other_form: bool) -> dict[str, float]:
    """Log evidence of each kind of remainder beside a set of effects, in the formulas'
    form or in another, which is no larger than such forms are.

    The doubt of the slips is one more noise, to a remainder as to an effect, and adds
    nothing: what is seen only where the slips are doubted is not seen in the data.
    """

    def found(*expected):
        columns = np.concatenate([linear.explained[:, :0], *expected], axis=1)
        return gains(base.generic, linear.explained, linear.residual, columns)

    forms = [linear.forms] if in_other_form else []
    sure = found(*forms)
    if not base.doubt.shape[1] or max(sure.values()) <= 0:
        return sure
    doubting = found(*forms, base.doubt)
    return {kind: min(value, doubting[kind]) for kind, value in sure.items()}


def fitted_form(linear: LinearFit) -> np.ndarray:
    """What the other forms add to the fit, whitened: (m,)."""
    left, size = orthogonal(linear.forms, linear.used_up)
    t = size**2
    return left @ (left.T @ linear.residual * t / (1 + t))
