"""A linear subject of the engine; one rich synthetic record and its diagnoses, each of
which compiles for seconds."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import null_space
from scipy.optimize import lsq_linear
from scipy.stats import multivariate_normal

from tirefit.data.read import read_frame
from tirefit.diagnosis.diagnose import diagnose
from tirefit.diagnosis.engine.discrepancy import Discrepancy
from tirefit.diagnosis.engine.fit import Fit, Folds, Priors, Start, fitted
from tirefit.diagnosis.engine.search import Weighed
from tirefit.diagnosis.rows.rig import Rig

FZ, SPEEDS = (2000.0, 4000.0, 6000.0), (6.0, 24.0)
RIG = Rig(noise={"fx_relative": 0.01, "sigma_x": 0.001})


def brush(slip, cpa2, mu, fz):
    """S(12) as printed, for either sign."""
    u = np.minimum(2 * cpa2 * np.abs(slip) / (3 * mu * fz), 1.0)
    return np.sign(slip) * mu * fz * (3 * u - 3 * u**2 + u**3)


def bare(key=(), **known):
    """A fitted set of effects with no further information."""
    blank = {"atoms": (), "effects": key, "z": np.zeros(0), "amplitude": np.zeros(0)}
    blank |= {"residual": np.zeros(1), "columns": np.zeros((1, 0))}
    blank |= {"pull": np.zeros(0), "off": np.zeros(0), "log_evidence": 0.0}
    return Fit(**blank | known)


def refitted(base, *effects):
    """A set of effects, refitted from one prior scale each."""
    names = [atom.effect.id for atom in base.atoms]
    atoms = tuple(sorted(names.index(effect) for effect in effects))
    return base.refit([Start(base.z, np.ones(len(atoms)))], [atoms])[0]


def weighed_of(alone, beside=None, **known):
    """A posterior by hand: probabilities of sets, and of sets with a discrepancy."""
    log, more = ({key: float(np.log(p)) for key, p in of.items()} for of in (alone, beside or {}))
    given = {"best_of": {key: bare(key) for key in log}, "log_weight": log}
    given |= {"log_beside": more, "evidence": {key: 9.0 * len(key) for key in log}}
    return Weighed(**given | {"log_total": 0.0, "hidden": 0.0} | known)


class Toy:
    """A linear subject of the engine with unit noise: observed = columns z + tangents a.

    Args:
        names: id of the effect of each tangent; ids of one family begin with its letter.
        low, center: of the amplitudes, whose priors are normal of unit width.
        smooth: discrepancy, none if not given.
        parts: number of blocks that are left out in turn.
        other: id of an effect -> ids of those that it is mistaken for.
    """

    floor, given_residual = 1.0, None

    def __init__(self, observed, columns, tangents, names, low=-9.0, center=0.0, **other):
        self.observed, self.columns, self.slopes = observed, columns, tangents
        count, self.names = len(names), names
        self.atoms = tuple(
            SimpleNamespace(
                effect=SimpleNamespace(
                    id=name, family=name[0], misleads=False, looks_like=other.get(name, ())
                )
            )
            for name in names
        )
        self.testable = tuple(range(count))
        full = (np.broadcast_to(value, count) + 0.0 for value in (center, low, 9.0, 0.0, 1.0))
        self.priors, self.start = Priors(*full), Start(np.zeros(columns.shape[1]), np.zeros(0))
        self.discrepancy = other.get("smooth", Discrepancy(np.zeros((len(observed), 0)), ()))
        self.unit = other.get("unit", np.ones(len(observed)))
        self.parts = other.get("parts", 6)

    def groups(self):
        return {"time": np.arange(len(self.observed)) + 0.0}

    def folds(self, effects):
        code = np.arange(len(self.observed)) * self.parts // len(self.observed)
        return Folds(code, f"{self.parts} blocks", is_covered=True)

    def refit(self, starts, sets):
        return [self.fit(atoms) for atoms in sets]

    def fit(self, atoms):
        """The best parameters and amplitudes within their bounds, by SciPy."""
        index, p = list(atoms), self.columns.shape[1]
        both = np.concatenate([self.columns, self.slopes[:, index]], axis=1)
        center, low, high = (part[index] for part in self.priors[:3])
        prior = np.eye(p + len(index))[p:]
        low, high = (np.append(np.full(p, far), x) for far, x in ((-np.inf, low), (np.inf, high)))
        target = np.append(self.observed, center)
        best = lsq_linear(np.vstack([both, prior]), target, (low, high), tol=1e-14).x
        linear = self.observed - both @ best, both
        return fitted(self, atoms, Start(best[:p], best[p:]), linear)

    def tangents(self, fit):
        return self.slopes


def log_normal(residual, covariance, flat):
    """Log density (plus a constant) of a residual with this covariance beside columns
    ``flat`` whose coefficients are free: projected out, dense."""
    unit = null_space(flat.T) if flat.shape[1] else np.eye(len(residual))
    return multivariate_normal(cov=unit.T @ covariance @ unit).logpdf(unit.T @ residual)


def record(change=None, seed=0, rows=40):
    """Sweeps of both signs at three loads and two speeds; ``change`` sets the truth.

    Args:
        change: (slip, time, fz, v) -> force [N]; the plain brush if None.
        rows: rows of each of the six sweeps.
    """
    generator = np.random.default_rng(seed)
    blocks, start = [], 0.0
    for fz in FZ:
        for v in SPEEDS:
            time = np.arange(rows) * 0.05
            slip = 0.25 * np.sin(2 * np.pi * time / 2.0)
            truth = change or (lambda s, t, fz, v: brush(s, 5e4, 0.9, fz))
            force = truth(slip, time + start, fz, v)
            blocks.append(
                np.stack([time + start, slip, force, 0 * time + fz, 0 * time + v], axis=1)
            )
            start += rows * 0.05 + 2.0
    time, slip, force, fz, v = np.concatenate(blocks).T
    noisy = force + 0.01 * fz * generator.standard_normal(len(fz))
    measured = slip + 0.001 * generator.standard_normal(len(fz))
    # The truth at the measured slip, so that noise of the slip is not a gap.
    force = force + brush(measured, 5e4, 0.9, fz) - brush(slip, 5e4, 0.9, fz)
    return {"time": time, "sigma_x": measured, "fx": noisy, "fz": fz, "v": v}, force


def lagging(slip, time, fz, v, length=0.5):
    """Relaxation by integration of its equation, from rest."""

    def slip_at(t):
        return np.interp(t, time, slip)

    found = solve_ivp(
        lambda t, y: v / length * (slip_at(t) - y),
        (time[0], time[-1]),
        [slip[0]],
        t_eval=time,
        max_step=0.005,
        rtol=1e-8,
    )
    return brush(found.y[0], 5e4, 0.9, fz)


TRUTHS = {
    "none": None,
    "slip_offset": lambda s, t, fz, v: brush(s + 0.004, 5e4, 0.9, fz),
    "load_friction": lambda s, t, fz, v: brush(s, 5e4, 0.9 * (fz / 4e3) ** -0.1, fz),
    "relaxation_length": lagging,
    "unknown": lambda s, t, fz, v: (
        brush(s, 5e4, 0.9, fz) + 0.06 * fz * np.sin(75 * np.abs(s)) * (np.abs(s) > 0.04)
    ),
}


@pytest.fixture(scope="session")
def diagnosed():
    """Diagnosis and noise-free truth by name of :data:`TRUTHS`."""
    known = {}

    def find(name):
        if name not in known:
            frame, force = record(TRUTHS[name], seed=3)
            known[name] = (diagnose(read_frame(frame, name), rig=RIG), force)
        return known[name]

    return find
