"""Wheels excited by the road, computed exactly at the samples by NumPy and SciPy."""

import numpy as np
from scipy.linalg import expm

RATE = 200.0
CORNER = 1.0
"""Hz, of the road's force; as of the simulated sensors and roads."""
SCALE = 1.2 / 0.3**2
"""J / r^2 [kg] of the wheels."""


def discrete(pole, corner=CORNER, rate=RATE):
    """Transition (2, 2) of (speed, force) over an interval and the Cholesky factor of
    the added noise, by Van Loan's block exponential; the force has unit variance."""
    c = 2 * np.pi * corner
    drift = np.array([[-pole, 1.0], [0.0, -c]])
    block = np.zeros((4, 4))
    block[:2, :2], block[2:, 2:] = -drift, drift.T
    block[1, 3] = 2 * c
    whole = expm(block / rate)
    transition = whole[2:, 2:].T
    return transition, np.linalg.cholesky(transition @ whole[:2, 2:])


def speeds(poles, m, seed=0, push=1.0, speed_noise=0.0, settled=2000):
    """Wheel speeds (n, m) [m/s] without their trend, at poles (n,) [1/s].

    Args:
        push: std of the road's force over J / r^2 [m/s2].
        settled: samples at the first pole that are thrown away.
    """
    random = np.random.default_rng(seed)
    poles = np.r_[np.full(settled, poles[0]), poles]
    made = {p: discrete(p) for p in set(poles.tolist())}
    state, rows = np.zeros((2, m)), []
    for pole in poles:
        transition, root = made[float(pole)]
        state = transition @ state + root @ random.normal(size=(2, m))
        rows.append(push * state[0])
    told = np.array(rows[settled:])
    return told + speed_noise * random.normal(size=told.shape)
