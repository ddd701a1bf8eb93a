"""How far the tire that a file holds misses the one that was to be exported."""

import numpy as np

from tirefit.fitting.tir import USUAL_SHARES, USUAL_SLIP
from tirefit.results import InputProblem, UsageError
from tirefit.targets.code import compiled
from tirefit.targets.tire import UNITS, Tire, turned_range

MOST = 0.05
"""Largest miss over the load that is written without being asked for."""

_SIGNS = "iso-w"


def check_loss(tire: Tire, held: Tire, target: str, force: bool) -> tuple[str, ...]:
    """A sentence on the largest miss within the measured range; none where it is exact.

    Raises:
        UsageError: the miss exceeds :data:`MOST` of the load, without ``force``.
    """
    if held.model is tire.model:
        return ()
    grid, told = _grid(tire)
    both = []
    for one in (tire, held):
        program = one.program(_SIGNS)
        found = compiled(program)(*(grid[name] for name in program.inputs))
        both.append(dict(zip(program.outputs, found, strict=True)))
    pure, missed, sizes = grid["kappa"] * grid["alpha"] == 0, [0.0], []
    for name in ("fx", "fy"):
        if all(name in found for found in both):
            off = np.abs(both[0][name] - both[1][name]) / grid["fz"]
            missed.append(float(np.max(off)))
            alone = float(np.max(off[pure]))
            sizes.append(f"{name} {missed[-1]:.2%} (in pure slip {alone:.2%})")
    sentence = f"largest miss of the file in F_z: {', '.join(sizes)}, over {told}"
    if max(missed) > MOST and not force:
        remedy = "export to c, casadi or numpy, which hold it, or accept it by --force"
        reason = f"{tire.name} for {target}: {sentence}; the limit is {MOST:.0%}"
        raise UsageError(InputProblem(reason, remedy))
    return (sentence,)


def _grid(tire: Tire) -> tuple[dict[str, np.ndarray], str]:
    """Slips and loads of usual size within the measured range, each (n,), and their
    range in words."""
    ends = turned_range(tire.measured, _SIGNS)
    sizes = {"kappa": 31, "alpha": 31, "fz": 5}
    usual = {"kappa": (-USUAL_SLIP, USUAL_SLIP), "alpha": (-USUAL_SLIP, USUAL_SLIP)}
    usual = {k: usual[k] for k in usual if k in ends} or usual
    usual["fz"] = USUAL_SHARES[0] * tire.load, USUAL_SHARES[-1] * tire.load
    within = {k: (0.0, 0.0) for k in sizes}
    for k, each in usual.items():
        low, high = np.clip(each, *ends.get(k, (-np.inf, np.inf)))
        within[k] = float(low), float(high)
    axes = [np.linspace(*within[k], n) for k, n in sizes.items()]
    kappa, alpha, fz = (x.ravel() for x in np.meshgrid(*axes, indexing="ij"))
    still = np.zeros(len(fz))
    told = [
        f"{k} {a:.3g} to {b:.3g} {UNITS[k]}"
        for k, (a, b) in within.items()
        if k in usual
    ]
    grid = {"kappa": kappa, "alpha": alpha, "fz": fz, "v": still + 10.0}
    return grid | {"gamma": still, "pressure": still}, ", ".join(told)
