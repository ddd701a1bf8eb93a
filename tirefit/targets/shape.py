"""Check an exported tire at rest, at large slip and at large load, where simulators can fail."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from tirefit.slip import CONVENTIONS
from tirefit.targets.code import compiled
from tirefit.targets.program import Program
from tirefit.targets.tire import Tire

_STEP = 1e-4
"""Step of the slip at zero by which slopes and jumps are found."""

_JUMP = 0.01
"""Largest change of the force over load within such a step, in addition to its slope."""

_SQUARE = 1.05
"""Largest resultant over the ellipse of the pure forces."""

_PLATEAU = 0.999
"""Share of the largest force above which the peak is reached."""

_SLIPS = np.linspace(-0.99, 0.99, 397)
_ANGLES = np.linspace(-1.2, 1.2, 241)
_FEW = _SLIPS[::4, None], _ANGLES[::4]
"""The same for both slips together."""


class Shape(NamedTuple):
    """Five sentences on a tire; ``failed``: those of them that report a failed check.
    ``curves``: force -> slip and pure force [N] of the file at the usual load."""

    sentences: tuple[str, ...]
    failed: tuple[str, ...]
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]]

    @property
    def sound(self) -> bool:
        """Whether the tire passes all checks."""
        return not self.failed


def shape_of(tire: Tire, program: Program, convention: str) -> Shape:
    """Check the forces of a tire, in single precision, up to twice the largest load."""
    signs = CONVENTIONS[convention]
    force, names = compiled(program), list(program.outputs)
    load, most = tire.load, 2 * tire.largest_load
    middle = {"v": tire.speed, "gamma": 0.0, "pressure": 0.0}

    def at(kappa=0.0, alpha=0.0, fz=load, **others) -> dict[str, np.ndarray]:
        values = middle | {"kappa": kappa, "alpha": alpha, "fz": signs.fz * fz} | others
        given = np.broadcast_arrays(*(values[k] for k in program.inputs))
        with np.errstate(all="ignore"):
            found = force(*(np.asarray(one, np.float32) for one in given))
        shape = given[0].shape
        return {n: np.broadcast_to(f, shape) for n, f in zip(names, found, strict=True)}

    found = [_at_rest(at, names, load), _standing(at, names, "v" in program.inputs)]
    found += [_signs(at, names, signs, load), _peaks(at, names, load, most)]
    found.append(_ellipse(at, names, most))
    grids = {"fx": _SLIPS, "fy": _ANGLES}
    pure = {n: (grids[n], at(**{_SLIP_OF[n]: grids[n]})[n]) for n in _forces(names)}
    failed = tuple(sentence for sentence, sound in found if not sound)
    return Shape(tuple(sentence for sentence, _ in found), failed, pure)


_SLIP_OF = {"fx": "kappa", "fy": "alpha"}


def _forces(names) -> list[str]:
    return [name for name in ("fx", "fy") if name in names]


def _at_rest(at: Callable, names, load) -> tuple[str, bool]:
    slopes, sound = [], True
    for name in _forces(names):
        slips = np.array([-2, -1, 0, 1, 2]) * _STEP
        f = at(**{_SLIP_OF[name]: slips})[name] / load
        left, right = (f[1] - f[0]) / _STEP, (f[4] - f[3]) / _STEP
        jump = max(abs(f[2] - f[1] - left * _STEP), abs(f[3] - f[2] - right * _STEP))
        smooth = bool(np.all(np.isfinite(f)) and jump < _JUMP)
        smooth &= abs(left - right) < 0.1 * max(abs(left), abs(right))
        sound &= smooth
        how, zero = "continuous" if smooth else "NOT continuous", f[2] + 0.0  # no -0
        slopes.append(f"{name} {how}, slope {(left + right) / 2:.4g} F_z, {zero:.3g} F_z at zero")
    return "zero slip: " + "; ".join(slopes), sound


def _standing(at: Callable, names, speed: bool) -> tuple[str, bool]:
    slips, angles = _FEW
    slips = np.concatenate([slips, [[-1.0], [1.0]]])
    forces = at(kappa=slips, alpha=angles, v=0.0)
    sound = all(np.all(np.isfinite(forces[name])) for name in names)
    how = "finite" if sound else "NOT finite"
    what = "speed zero and a locked wheel" if speed else "a locked wheel"
    return f"standstill: every force is {how} at {what}", sound


def _signs(at: Callable, names, signs, load) -> tuple[str, bool]:
    directions, sound = [], True
    for name in _forces(names):
        slip = _SLIP_OF[name]
        f = at(**{slip: np.array([-0.02, 0.02])})[name]
        own = getattr(signs, "slip" if slip == "kappa" else slip) * getattr(signs, name)
        right = bool((f[1] - f[0]) * own > 0)
        sound &= right
        directions.append(f"{name} {'rises' if f[1] > f[0] else 'falls'} with {slip}")
    word = "as the convention requires" if sound else "AGAINST the convention"
    return f"signs: {', '.join(directions)}, {word}", sound


def _peaks(at: Callable, names, load, most) -> tuple[str, bool]:
    peaks, sound = [], True
    for name in _forces(names):
        slip, grid = _SLIP_OF[name], _SLIPS if name == "fx" else _ANGLES
        each = []
        for fz in (load, most):
            f = np.abs(at(**{slip: grid}, fz=fz)[name]) / fz
            place = int(np.argmax(f))
            sound &= bool(np.isfinite(f).all() and f[place] < 5)
            # The peak of a plateau is its beginning.
            first = np.abs(grid)[f >= _PLATEAU * f[place]].min(initial=np.inf)
            each.append(f"{f[place]:.3g} F_z at {first:.2g}")
        peaks.append(f"{name} {each[0]} (twice the largest load: {each[1]})")
    return "peak: " + "; ".join(peaks), sound


def _ellipse(at: Callable, names, most) -> tuple[str, bool]:
    if _forces(names) != ["fx", "fy"]:
        return "combined slip: only one force", True
    worst = 0.0
    for fz in (0.5 * most, most):
        grid = at(kappa=_FEW[0], alpha=_FEW[1], fz=fz)
        pure_x = np.max(np.abs(at(kappa=_SLIPS, fz=fz)["fx"]))
        pure_y = np.max(np.abs(at(alpha=_ANGLES, fz=fz)["fy"]))
        size = np.hypot(grid["fx"] / pure_x, grid["fy"] / pure_y)
        worst = max(worst, float(np.nanmax(size)))
    sound = worst < _SQUARE
    how = "within" if sound else "NOT within"
    return (
        f"combined slip: at most {worst:.3f} of the ellipse of the pure forces, {how}"
        f" {_SQUARE:g} of it, to F_z {most:.4g} N"
    ), sound
