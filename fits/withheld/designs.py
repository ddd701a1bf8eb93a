"""Designs of measurements: the inputs of every row.

Slips are sigma_x, or tan(alpha) in the lateral designs. Rows are in the order of time.
"""

from typing import NamedTuple

import numpy as np

from fits.withheld.patch import World

__all__ = ["DESIGNS", "Design", "make_world"]


class Design(NamedTuple):
    """``order``: "random" points in blocks, "sweeps" in time, "pulses", "slalom".

    ``lowest``/``highest``: range of slip. ``shuffled``: loads and speeds in random order
    instead of in blocks. ``sealed``: not used in development.
    """

    loads: tuple[float, ...]
    speeds: tuple[float, ...]
    lowest: float
    highest: float
    order: str = "random"
    shuffled: bool = False
    force: str = "fx"
    moment: bool = False
    sealed: bool = False

    @property
    def properties(self) -> set[str]:
        """Properties that effects may need (``needs``), without columns."""
        return {
            *({"loads"} if len(self.loads) > 1 else ()),
            *({"speeds"} if len(self.speeds) > 1 else ()),
            *({"signs"} if self.lowest < 0 else ()),
            *({"sweeps"} if self.order != "random" else ()),
            *({"knee"} if self.highest > 0.1 else ()),
            "longitudinal" if self.force == "fx" else "lateral",
        }


LOADS, SPEEDS = (2000.0, 4000.0, 6000.0), (5.0, 15.0, 30.0)
DESIGNS = {
    "A": Design((4000.0,), (15.0,), 0, 0.05),
    "B": Design((4000.0,), (15.0,), 0, 0.3),
    "C": Design(LOADS, (15.0,), 0, 0.3),
    "D": Design((4000.0,), SPEEDS, 0, 0.3, sealed=True),
    "E": Design(LOADS, SPEEDS, 0, 0.3),
    "F": Design(LOADS, SPEEDS, -0.3, 0.3, shuffled=True),
    "G": Design(LOADS, SPEEDS, -0.3, 0.3, "sweeps"),
    "S": Design((2500.0, 3500.0, 5500.0), (8.0, 22.0), -0.2, 0.2, "sweeps", sealed=True),
    "V": Design((4000.0,), (20.0,), 0, 0.15, "pulses"),
    "H": Design(LOADS, SPEEDS, -0.25, 0.25, "sweeps", force="fy", moment=True),
    "L": Design(LOADS, (15.0,), -0.25, 0.25, shuffled=True, force="fy"),
    "T": Design((4000.0,), (20.0,), -0.15, 0.15, "slalom", force="fy", moment=True, sealed=True),
}

POINT = 0.5  # s, one steady point
SWEEP, PAUSE = 4.0, 2.0  # s
PULSE = 0.6  # s


def _shares(n: int, parts: int) -> np.ndarray:
    """(n,) index of the part of each row, in order, with parts of nearly equal length."""
    return np.arange(n) * parts // n


def _triangle(phase: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 -> high -> low -> 0 over phase 0..1 (0 -> high -> 0 where low is 0)."""
    if low == 0:
        return high * (1 - np.abs(2 * phase - 1))
    return np.interp(phase, [0, 0.25, 0.75, 1], [0, high, low, 0])


def _steady(design: Design, n: int, generator):
    cells = [(z, v) for v in design.speeds for z in design.loads]
    cell = _shares(n, len(cells))
    if design.shuffled:
        cell = generator.permutation(cell)
    fz, v = np.array(cells)[cell].T
    slip = generator.uniform(design.lowest, design.highest, n)
    return POINT * np.arange(n), np.zeros(n, int), slip, fz, v


def _sweeps(design: Design, n: int, generator):
    cells = [(z, v) for v in design.speeds for z in design.loads]
    run = _shares(n, len(cells))
    fz, v = np.array(cells)[generator.permutation(len(cells))][run].T
    phase = np.zeros(n)
    for k in range(len(cells)):
        rows = run == k
        phase[rows] = np.linspace(0, 1, rows.sum())
    slip = _triangle(phase, design.lowest, design.highest)
    return SWEEP * phase + (SWEEP + PAUSE) * run, run, slip, fz, v


def _pulses(design: Design, n: int, generator):
    """Saw-tooth braking at 100 Hz: slow rise, quick release; the load rises with braking."""
    time = 0.01 * np.arange(n)
    number = np.floor(time / PULSE).astype(int)
    height = generator.uniform(0.4, 1, number.max() + 1)[number]
    phase = time / PULSE % 1
    slip = design.highest * height * np.interp(phase, [0, 0.7, 0.85, 1], [0, 1, 0, 0])
    wave = np.sin(2 * np.pi * 0.3 * time + generator.uniform(0, 6))
    fz = design.loads[0] * (1 + 0.15 * slip / design.highest + 0.03 * wave)
    v = design.speeds[0] * (1 + 0.02 * np.cos(2 * np.pi * 0.11 * time))
    return time, np.zeros(n, int), slip, fz, v


def _slalom(design: Design, n: int, generator):
    """A sine of growing amplitude at 100 Hz; the load changes with the cornering."""
    time = 0.01 * np.arange(n)
    growth = 0.3 + 0.7 * time / time.max()
    wave = np.sin(2 * np.pi * 0.5 * time) * growth
    fz = design.loads[0] * (1 + 0.2 * wave)
    v = np.full(n, design.speeds[0])
    return time, np.zeros(n, int), design.highest * wave, fz, v


_ORDERS = {"random": _steady, "sweeps": _sweeps, "pulses": _pulses, "slalom": _slalom}


def make_world(design: Design, n: int, c: float, mu: float, generator) -> World:
    """A plain tire in this design, with every column that an effect may need."""
    time, run, slip, fz, v = _ORDERS[design.order](design, n, generator)
    world = World(time, run, slip, fz, v, design.force, c, mu, moment=design.moment)
    elapsed = (time - time.min()) / (time.max() - time.min())
    wave = np.sin(2 * np.pi * (1.5 * elapsed + generator.uniform()))
    world.temperature = 45 + 10 * elapsed + 10 * wave
    swing = np.sin(2 * np.pi * (3.3 * elapsed + generator.uniform()))
    world.gamma = 0.05 * swing + 0.02 * generator.choice([-1, 1])
    world.cross = 0.05 * np.abs(np.cos(np.pi * (2.3 * elapsed + generator.uniform())))
    # Four inflation pressures and a sinusoidal cross force, both without random draws.
    filling = np.floor(4 * ((2.6 * elapsed + 0.2) % 1))
    world.inflation = 2.2e5 * (0.8 + 0.4 / 3 * filling)
    world.across = 0.5 * mu * fz * np.sin(2 * np.pi * 4.7 * elapsed + 1)
    return world
