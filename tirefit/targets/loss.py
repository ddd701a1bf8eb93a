"""Compare the tire of an exported file with the original."""

from collections.abc import Mapping

import numpy as np

from tirefit.fitting.tir import USUAL_SHARES, USUAL_SLIP
from tirefit.models import TireInputs, forces
from tirefit.results import InputProblem, UsageError
from tirefit.slip import sigma_from_kappa
from tirefit.targets.tire import UNITS, Tire, turned_range

MOST = 0.05
"""Largest error over the load that is written without ``force``."""

_SLIP_OF = {"fx": "kappa", "fy": "alpha"}


def grid_of(
    ranges: Mapping[str, tuple[float, float]], kappa: int, alpha: int, fz: int
) -> np.ndarray:
    """Slips and loads (3, n) on a grid with these numbers of points; with 0, a slip is zero."""
    counts = {"kappa": kappa, "alpha": alpha, "fz": fz}
    axes = [np.linspace(*ranges[k], n) if n else [0.0] for k, n in counts.items()]
    return np.stack([one.ravel() for one in np.meshgrid(*axes, indexing="ij")])


def check_loss(tire: Tire, held: Tire, target: str, force: bool) -> tuple[str, ...]:
    """A sentence on the largest error within the measured range, over usual slips where
    a slip was not measured; none if it is exact.

    Raises:
        UsageError: the error exceeds :data:`MOST` of the load, without ``force``.
    """
    if held.model is tire.model:
        return ()
    compared = [f for f in _SLIP_OF if f in tire.modelled and f in held.modelled]
    # A force whose slip was not measured, like fx of a fit to fy, is in the file as well.
    slips = [_SLIP_OF[force] for force in compared]
    ranges = dict.fromkeys(slips, (-USUAL_SLIP, USUAL_SLIP))
    ranges["fz"] = USUAL_SHARES[0] * tire.load, USUAL_SHARES[-1] * tire.load
    for name, ends in ranges.items():
        low, high = np.clip(ends, *tire.measured.get(name, (-np.inf, np.inf)))
        ranges[name] = float(low), float(high)
    along, across = (31 if k in slips else 0 for k in _SLIP_OF.values())
    kappa, alpha, fz = grid_of(ranges, along, across, 5)
    at = TireInputs(sigma_from_kappa(kappa), alpha, fz, tire.speed)
    both = [forces(one.model, at)._asdict() for one in (tire, held)]
    pure, missed, sizes = kappa * alpha == 0, [0.0], []
    for name in compared:
        off = np.abs(both[0][name] - both[1][name]) / fz
        missed.append(float(np.max(off)))
        alone = float(np.max(off[pure]))
        sizes.append(f"{name} {missed[-1]:.2%} (in pure slip {alone:.2%})")
    where = ", ".join(
        f"{k} {a:.3g} to {b:.3g} {UNITS[k]}" for k, (a, b) in turned_range(ranges, "iso-w").items()
    )
    sentence = f"largest error of the file in F_z: {', '.join(sizes)}, over {where}"
    if max(missed) > MOST and not force:
        remedy = "export to c, casadi or numpy, which hold it, or accept it by --force"
        reason = f"{tire.name} for {target}: {sentence}; the limit is {MOST:.0%}"
        raise UsageError(InputProblem(reason, remedy))
    return (sentence,)
