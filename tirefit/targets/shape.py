"""Check an exported tire at rest, at large slip and at large load, where simulators can fail."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tirefit.targets.code import compiled
from tirefit.targets.program import Program
from tirefit.targets.tire import Tire, sign_of

_STEP = 1e-4  # step of the slip at zero by which slopes and jumps are found
_JUMP = 0.01  # largest change of the force over load within such a step, in addition to its slope
_SQUARE = 1.05  # largest resultant over the ellipse of the pure forces
_PLATEAU = 0.999  # share of the largest force above which the peak is reached
_SLIPS, _ANGLES = np.linspace(-0.99, 0.99, 397), np.linspace(-1.2, 1.2, 241)
_PURE = {"fx": ("kappa", _SLIPS), "fy": ("alpha", _ANGLES)}  # force -> its slip, and values of it
_FEW = _SLIPS[::4, None], _ANGLES[::4]  # the same for both slips together


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
    force, names = compiled(program), list(program.outputs)
    load = tire.load
    most = 2 * max(load, tire.measured.get("fz", (0.0, 0.0))[1])
    middle = {"v": tire.speed, "gamma": 0.0, "pressure": 0.0}

    def at(
        kappa: ArrayLike = 0.0, alpha: ArrayLike = 0.0, fz: float = load, **others: ArrayLike
    ) -> dict[str, np.ndarray]:
        loaded = sign_of(convention, "fz") * fz
        values = middle | {"kappa": kappa, "alpha": alpha, "fz": loaded} | others
        given = np.broadcast_arrays(*(values[k] for k in program.inputs))
        with np.errstate(all="ignore"):
            forces = force(*(np.asarray(value, np.float32) for value in given))
        shape = given[0].shape
        return {n: np.broadcast_to(f, shape) for n, f in zip(names, forces, strict=True)}

    def along(name: str, slips: np.ndarray, fz: float = load) -> np.ndarray:
        """A force at values of its own slip alone."""
        return at(**{_PURE[name][0]: slips}, fz=fz)[name]

    given = [name for name in _PURE if name in names]
    speed = f" at {tire.speed:.4g} m/s" if "v" in program.inputs else ""
    checks = [
        _joined(f"zero slip{speed}", [_at_rest(name, along, load) for name in given]),
        _standing(at, names, "v" in program.inputs),
        _signs(along, given, convention),
        _joined(f"peak{speed}", [_peak(name, along, (load, most)) for name in given]),
        _ellipse(at, along, given, most),
    ]
    pure = {name: (_PURE[name][1], along(name, _PURE[name][1])) for name in given}
    failed = tuple(sentence for sentence, sound in checks if not sound)
    return Shape(tuple(sentence for sentence, _ in checks), failed, pure)


def _joined(title: str, checks: list[tuple[str, bool]]) -> tuple[str, bool]:
    """The checks of each force as one."""
    return f"{title}: {'; '.join(text for text, _ in checks)}", all(ok for _, ok in checks)


def _at_rest(name: str, along: Callable[..., Any], load: float) -> tuple[str, bool]:
    f = along(name, np.array([-2, -1, 0, 1, 2]) * _STEP) / load
    left, right = (f[1] - f[0]) / _STEP, (f[4] - f[3]) / _STEP
    jump = max(abs(f[2] - f[1] - left * _STEP), abs(f[3] - f[2] - right * _STEP))
    smooth = bool(np.all(np.isfinite(f)) and jump < _JUMP)
    smooth &= abs(left - right) < 0.1 * max(abs(left), abs(right))
    how, zero = "continuous" if smooth else "NOT continuous", f[2] + 0.0  # no -0
    return f"{name} {how}, slope {(left + right) / 2:.4g} F_z, {zero:.3g} F_z at zero", smooth


def _standing(at: Callable[..., Any], names: Iterable[str], speed: bool) -> tuple[str, bool]:
    slips = np.concatenate([_FEW[0], [[-1.0], [1.0]]])
    forces = at(kappa=slips, alpha=_FEW[1], v=0.0)
    sound = all(np.all(np.isfinite(forces[name])) for name in names)
    how = "finite" if sound else "NOT finite"
    what = "speed zero and at a locked wheel" if speed else "a locked wheel"
    return f"standstill: every force is {how} at {what}", sound


def _signs(along: Callable[..., Any], given: Iterable[str], convention: str) -> tuple[str, bool]:
    directions, sound = [], True
    for name in given:
        slip = _PURE[name][0]
        rise = np.diff(along(name, np.array([-0.02, 0.02])))[0]
        sound &= bool(rise * sign_of(convention, slip) * sign_of(convention, name) > 0)
        directions.append(f"{name} {'rises' if rise > 0 else 'falls'} with {slip}")
    word = "as the convention requires" if sound else "AGAINST the convention"
    return f"signs: {', '.join(directions)}, {word}", sound


def _peak(name: str, along: Callable[..., Any], loads: Iterable[float]) -> tuple[str, bool]:
    each, sound, grid = [], True, _PURE[name][1]
    for fz in loads:
        f = np.abs(along(name, grid, fz)) / fz
        top = f[np.argmax(f)]
        sound &= bool(np.isfinite(f).all() and top < 5)
        # The peak of a plateau is its beginning.
        first = np.abs(grid)[f >= _PLATEAU * top].min(initial=np.inf)
        slip = f"{_PURE[name][0]} {first:.2g}{' rad' * (name == 'fy')}"
        each.append(f"{top:.3g} F_z at {slip}")
    return f"{name} {each[0]} (twice the largest load: {each[1]})", sound


def _ellipse(
    at: Callable[..., Any], along: Callable[..., Any], given: Sequence[str], most: float
) -> tuple[str, bool]:
    if len(given) < 2:
        return "combined slip: not checked, as the file has only one force", True
    worst = 0.0
    for fz in (0.5 * most, most):
        both = at(kappa=_FEW[0], alpha=_FEW[1], fz=fz)
        shares = [both[k] / np.max(np.abs(along(k, _PURE[k][1], fz))) for k in given]
        worst = max(worst, float(np.nanmax(np.hypot(*shares))))
    sound = worst < _SQUARE
    how = "within" if sound else "NOT within"
    return (
        f"combined slip: at most {worst:.3f} of the ellipse of the pure forces, {how}"
        f" {_SQUARE:g} of it, to F_z {most:.4g} N"
    ), sound
