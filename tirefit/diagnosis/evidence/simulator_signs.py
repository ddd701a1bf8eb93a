"""Test whether a simulator fits the data with some signs reversed.

They are reversed in a tire that was written in other axes, or for the other side of the
vehicle.
"""

from collections.abc import Collection, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from tirefit.data.table import CANONICAL
from tirefit.diagnosis.evidence.simulator import Given
from tirefit.diagnosis.evidence.tire import Tire
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.fitting.tir import TIR_SIGNS
from tirefit.models import TireInputs, forces
from tirefit.models.mf import OTHER_SIDE
from tirefit.models.mf.tire import turned_forces, turned_inputs
from tirefit.padding import pad_rows, padded_size
from tirefit.params import with_values
from tirefit.results import DataError, InputProblem
from tirefit.slip import CONVENTIONS

_ADAPTED = 0.3
"""Relative change of the parameters that is fitted under every hypothesis: a misfit
that such a change explains does not come from signs."""

_STEP = 1e-4
"""Step in z of the finite differences; its effect is far above rounding."""

_FELT = 0.1
"""Smallest effect of the signs on a channel, as a share of its squared misfit, for the
channel to count."""

_CLEAR = 0.5
"""Largest share of the squared misfit that may remain with the right signs."""

_NEAR = 0.2
"""Largest deviation from 1 of the factor at which the change by the signs fits best. An
offset of the slip can have the same shape, but at any factor."""

_ALIKE = 1.02
"""Ratio of squared misfits below which two hypotheses are not distinguished."""


class _Misfit(NamedTuple):
    """The misfit of a channel with some signs reversed.

    ``rms`` is the root mean square misfit, ``square`` the mean square with adapted
    parameters, ``change`` the mean square change of the force by the signs, and
    ``factor`` the factor of this change that fits best.
    """

    rms: float
    square: float
    change: float
    factor: float


def check_signs(prepared: Prepared, tire: Tire, z, given: Given) -> str:
    """A sentence if a simulator fits better with other signs, else an empty text.

    Args:
        tire: the tire of the simulator, or its replacement, with parameters z.

    Raises:
        DataError: a file or columns fit with other signs, and no signs were declared. A
            diagnosis would then name some effect in place of the wrong signs.
    """
    there = _fields_there(prepared)
    as_given = _misfits(prepared, tire, z, frozenset())
    left: dict[frozenset[str], float] = {}
    for turned in _hypotheses(there):
        misfits = _misfits(prepared, tire, z, turned)
        shares = {c: m.square / as_given[c].square for c, m in misfits.items()}
        felt = [c for c, m in misfits.items() if m.change > _FELT * as_given[c].square]
        near = all(abs(misfits[c].factor - 1) < _NEAR and shares[c] < 1 for c in felt)
        if felt and near and np.mean([shares[c] for c in felt]) < _CLEAR:
            left[turned] = sum(shares.values())
    if not left:
        return ""
    alike = [h for h in left if left[h] <= _ALIKE * min(left.values())]
    now = _misfits(prepared, tire, z, alike[0])
    better = ", ".join(
        f"{c} {as_given[c].rms:.3g} -> {m.rms:.3g} {CANONICAL[c][0]} rms"
        f" ({as_given[c].square ** 0.5:.3g} -> {m.square**0.5:.3g} if adapted too)"
        for c, m in now.items()
        if m.change > _FELT * as_given[c].square
    )
    ways = " or ".join(map(_text, alike))
    reason = f"the simulator {given.source} fits if it is mirrored in {ways}: {better}"
    remedy = "; ".join(_remedies(alike, there, prepared, given))
    if given.signs or given.kind not in ("tir", "columns"):
        return f"{reason}. It is taken as it is: {remedy}"
    data = prepared.data
    raise DataError(InputProblem(reason, remedy, data.source.path or data.name))


def _text(turned: Collection[str]) -> str:
    """The columns with reversed signs, as a text."""
    names = [name for name in CONVENTIONS[TIR_SIGNS]._fields if name in turned]
    return " and ".join(map(_column, names))


def _column(field: str) -> str:
    return "sigma_x" if field == "slip" else field


def _fields_there(prepared: Prepared) -> frozenset[str]:
    """Fields of a convention that matter: the forces, and inputs that are not all 0."""
    inputs = _inputs(prepared)._asdict()
    felt = [f for f in ("slip", "alpha", "gamma") if np.any(inputs[_column(f)])]
    return frozenset((*felt, *prepared.channels))


def _inputs(prepared: Prepared) -> TireInputs:
    """All inputs as measured, padded."""
    size, names = padded_size(prepared.n), TireInputs._fields
    there = {n: prepared.column(n) for n in names if n in prepared.data}
    padded = {n: pad_rows(np.nan_to_num(v), size) for n, v in there.items()}
    return TireInputs(*(padded.get(n, np.zeros(size)) for n in names))


def _hypotheses(there: frozenset[str]) -> list[frozenset[str]]:
    """Sets of fields to reverse: differences of two conventions, the other side of the
    vehicle, and single fields."""
    pairs = combinations(CONVENTIONS.values(), 2)
    sets = [*(one.turned(other) for one, other in pairs), OTHER_SIDE]
    sets += [frozenset((name,)) for name in ("gamma", "fx", "fy", "mz")]
    return [h for h in dict.fromkeys(h & there for h in sets) if h]


def _misfits(
    prepared: Prepared, tire: Tire, z, turned: frozenset[str]
) -> Mapping[str, _Misfit]:
    """The misfit of each channel with the signs of ``turned`` reversed."""
    n, inputs = prepared.n, _inputs(prepared)
    run = pad_rows(prepared.run, padded_size(n))

    def of(z, turned=turned):
        model = with_values(tire.model, tire.layout.natural(z))
        found = forces(model, turned_inputs(inputs, turned), run)
        every = turned_forces(found, turned)._asdict()
        return {c: np.asarray(every[c])[:n] for c in prepared.channels}

    z = np.asarray(z, float)
    here, plain, values = of(z), of(z, frozenset()), tire.layout.vector(z)
    slopes = []
    for i, step in enumerate(_STEP * np.eye(len(z))):
        moved = abs(tire.layout.vector(z + step) - values)[i]
        unit = _ADAPTED * abs(values[i]) / max(moved, NONZERO)
        slopes.append(
            {c: unit * (force - here[c]) for c, force in of(z + step).items()}
        )
    found = {}
    for c, force in here.items():
        change = force - plain[c]
        gap = prepared.observed[c] - prepared.column(f"{c}_sim")
        columns = np.array([slope[c] for slope in slopes]).reshape(len(z), n).T
        none, once, twice = (_adapted(gap - k * change, columns) for k in (0, 1, 2))
        # Minimum of the parabola through the three mean squares.
        bend = 2 * (none - 2 * once + twice)
        factor = (3 * none - 4 * once + twice) / bend if bend > 0 else 0.0
        rms = float(np.sqrt(np.mean((gap - change) ** 2)))
        square = max(once, NONZERO)
        found[c] = _Misfit(rms, square, float(np.mean(change**2)), factor)
    return found


def _adapted(gap: np.ndarray, columns: np.ndarray) -> float:
    """Mean square of a gap (n,) after fitting bounded changes of the parameters."""
    best = np.linalg.lstsq(columns, gap, rcond=None)[0]
    best /= max(1.0, np.max(abs(best), initial=0.0))
    return float(np.mean((gap - columns @ best) ** 2))


def _remedies(
    alike: list[frozenset[str]], there: frozenset[str], prepared: Prepared, given: Given
) -> list[str]:
    """Options that declare the signs of a hypothesis, or the present signs."""
    source, ways = prepared.data.source, []
    now = CONVENTIONS[given.signs or TIR_SIGNS]
    for name, other in CONVENTIONS.items():
        if given.kind == "tir" and now.turned(other) & there in alike:
            ways.append(f"--signs {name} reads the file so")
    if given.kind == "tir" and OTHER_SIDE & there in alike:
        ways.append("--side, if it is a tire of the other side of the vehicle")
    if source.convention_from.startswith("assumed"):
        read = CONVENTIONS[source.convention]
        ways += [
            f"--convention {name} reads the data so, which declare none"
            for name, other in CONVENTIONS.items()
            if other.fz == read.fz and read.turned(other) & there in alike
        ]
    for (name,) in (h for h in alike if len(h) == 1):
        unit = source.units.get(name, CANONICAL[_column(name)][0]).replace(" ", "")
        ways.append(f"--unit {_column(name)}=-{unit}, if that column alone is turned")
    ways = ways or ["turn these signs in the simulator, or in the data"]
    kept = given.signs or (TIR_SIGNS if given.kind == "tir" else source.convention)
    return [*ways, f"--signs {kept} keeps it as it is"]
