"""What each set of effects predicts of the rows that its fit did not see."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import softmax

from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.search import Hypothesis
from tirefit.diagnosis.left_out.folds import Folds
from tirefit.diagnosis.negligible import FLAT
from tirefit.diagnosis.rows.basis import SCALES


class Predicted(NamedTuple):
    """Sets of effects fitted without each fold and judged on it.

    ``on`` names the folds, ``across_runs`` says that they are whole runs. ``loss``
    (F, S) is the mean square [N^2] of what set s misses of the first channel in fold f,
    ``whitened`` (F, S) the sum of squares of all channels over the noise, ``rows`` (F,)
    of the fold, ``amplitude`` the effects' own as refitted, by set: (F, k), in prior
    scales. ``smooth`` (F,) is the loss of anything smooth, ``climbed`` the set that a
    climb over whole runs ends at.
    """

    on: str
    across_runs: bool
    effects: tuple[tuple[str, ...], ...]
    loss: np.ndarray
    whitened: np.ndarray
    rows: np.ndarray
    amplitude: tuple[np.ndarray, ...]
    smooth: np.ndarray
    climbed: tuple[str, ...] = ()


def predicted(base: Base, sets: Sequence[Hypothesis], folds: Folds) -> Predicted:
    """Refit every set without each fold in turn, from its fit to all rows."""
    n, main = base.rows.n, base.rows.channels[0]
    keep = np.asarray(base.design.keep)[:n] > 0
    names = sorted(base.rows.observed)
    observed = np.stack([base.rows.observed[c] for c in names])
    scale = np.stack([np.asarray(base.design.scale[c])[:n] for c in names])
    starts, atoms = [(h.z, h.amplitude) for h in sets], [h.atoms for h in sets]
    outs = [folds.code == fold for fold in range(folds.number)]
    refit = base.refit_folds(starts, atoms, [~out for out in outs])
    loss = np.empty((folds.number, len(sets)))
    whitened, rows = np.empty_like(loss), np.empty(folds.number, int)
    for f, out in enumerate(outs):
        good = out & keep if (out & keep).any() else out
        rows[f] = good.sum()
        fits = [
            (refit.z[f, k], base.amplitudes(own, refit.amplitude[f, k]))
            for k, own in enumerate(atoms)
        ]
        missed = (observed - base.forces_each(fits))[:, :, good]
        loss[f] = np.mean(missed[:, names.index(main)] ** 2, axis=1)
        whitened[f] = np.sum((missed / scale[:, good]) ** 2, axis=(1, 2))
    amplitude = np.asarray(refit.amplitude)
    sizes_of = tuple(amplitude[:, k, : len(h.atoms)] for k, h in enumerate(sets))
    keys = tuple(tuple(sorted(h.effects)) for h in sets)
    smooth = smooth_predicted(base, folds)
    return Predicted(
        folds.on, folds.across_runs, keys, loss, whitened, rows, sizes_of, smooth
    )


def smooth_predicted(base: Base, folds: Folds) -> np.ndarray:
    """Mean square [N^2] of what "anything smooth" misses of each fold: (F,).

    The smooth functions of the discrepancy beside the base model, linearised at its
    fit, of each size by its evidence on the other rows.
    """
    n, main = base.rows.n, base.rows.channels[0]
    residual, jacobian, *_ = base.at_null
    columns, p = np.concatenate([jacobian, base.generic.smooth], 1), jacobian.shape[1]
    keep = np.asarray(base.design.keep)[:n] > 0
    scale, losses = np.asarray(base.design.scale[main])[:n], []
    channels = len(base.rows.channels)
    for fold in range(folds.number):
        out = folds.code == fold
        inside = np.tile(keep & ~out, channels)
        good = keep & out if (keep & out).any() else out
        own, rest = columns[inside], residual[inside]
        gram, score = own.T @ own, own.T @ rest
        logs, fits = [], []
        for size in SCALES:
            ridge = np.full(columns.shape[1], size**-2.0)
            ridge[:p] = FLAT
            factor = cho_factor(gram + np.diag(ridge))
            found = cho_solve(factor, score)
            log = 0.5 * score @ found - np.sum(np.log(np.diag(factor[0])))
            log += 0.5 * np.sum(np.log(ridge[p:]))
            logs.append(log)
            fits.append(found)
        weights = softmax(logs) @ np.array(fits)
        left = (residual[:n] - columns[:n] @ weights)[good] * scale[good]
        losses.append(np.mean(left**2))
    return np.array(losses)
