"""One rich synthetic record and its diagnoses, each of which compiles for seconds."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tirefit.data.read import read_frame
from tirefit.diagnosis.engine import diagnose
from tirefit.diagnosis.evidence.posterior import Weighed
from tirefit.diagnosis.evidence.search import Hypothesis
from tirefit.diagnosis.rows.patterns import Over, Patterns
from tirefit.diagnosis.rows.rig import Rig

FZ, SPEEDS = (2000.0, 4000.0, 6000.0), (6.0, 24.0)
RIG = Rig(noise={"fx_relative": 0.01, "sigma_x": 0.001})


def brush(slip, cpa2, mu, fz):
    """S(12) as printed, for either sign."""
    u = np.minimum(2 * cpa2 * np.abs(slip) / (3 * mu * fz), 1.0)
    return np.sign(slip) * mu * fz * (3 * u - 3 * u**2 + u**3)


def patterns_of(columns):
    """Patterns of these columns, all equally likely."""
    rows, count = columns.shape
    over = Over(
        "time",
        columns.astype(np.float32),
        [("local", k, 1) for k in range(count)],
        np.full(count, -np.log(max(count, 1))),
        {"force": 0},
    )
    return Patterns(np.ones((1, rows, 1)), [over])


def bare(key=(), **known):
    """A refitted set of effects with no further information."""
    none = np.zeros(0)
    blank = {"atoms": (), "effects": key, "log_evidence": 0.0, "log_prior": 0.0}
    blank |= {"z": none, "amplitude": none, "covariance": np.zeros((0, 0))}
    return Hypothesis(**blank | {"chi2": 0.0} | known)


def refitted(base, *effects):
    """A set of effects, refitted from one prior scale each."""
    names = [atom.effect.id for atom in base.atoms]
    atoms = tuple(sorted(names.index(effect) for effect in effects))
    refit = base.refit([(base.z, np.ones(len(atoms)))], [atoms])
    p, size = len(refit.z[0]), len(atoms)
    return bare(
        tuple(names[k] for k in atoms),
        atoms=atoms,
        z=refit.z[0],
        amplitude=refit.amplitude[0][:size],
        covariance=refit.covariance[0][: p + size, : p + size],
    )


def weighed_of(alone, beside=None, **known):
    """A posterior by hand: probabilities of sets, and of sets with a discrepancy."""
    log, more = ({key: float(np.log(p)) for key, p in of.items()} for of in (alone, beside or {}))
    given = {"best_of": {key: bare(key) for key in log}, "log_weight": log}
    given |= {"log_beside": more, "evidence": {key: 9.0 * len(key) for key in log}}
    given |= {"other_form": frozenset(), "gains": {}, "log_total": 0.0, "hidden": 0.0}
    return Weighed(**given | known)


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
