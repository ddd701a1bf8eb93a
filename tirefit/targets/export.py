"""A fitted tire as a file of another program: :func:`export`."""

import keyword
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from tirefit import __version__
from tirefit.data.write import output_problems
from tirefit.files import write_text_atomic
from tirefit.results import InputProblem, UsageError, did_you_mean
from tirefit.slip import CONVENTIONS
from tirefit.targets.code import (
    Draft,
    c_source,
    casadi_source,
    header,
    numpy_source,
)
from tirefit.targets.mujoco import mujoco_source
from tirefit.targets.parameters import (
    PARAMETER_FILES,
    SIGNS,
    ParameterFile,
    one_line,
    parameter_text,
)
from tirefit.targets.shape import Shape, shape_of
from tirefit.targets.tire import tire_of

MARK = "written by tirefit export"
"""What the first line of every exported file says."""

_TAKEN = frozenset(
    "auto case char const default do double enum extern float goto inline int long"
    " register restrict short signed sizeof static struct switch typedef union unsigned"
    " void volatile np ca sysid_parameters".split()
)
"""Words of C that are none of Python, and other names in the Python files."""


class Target(NamedTuple):
    """A program that an export is for.

    Attributes:
        ending: of the file.
        what: what the file is, and what it needs.
        holds: the models that it holds, and how exactly.
        write: the text of the file.
    """

    ending: str
    what: str
    holds: str
    write: Callable[[Draft], str]


TARGETS: dict[str, Target | ParameterFile] = {
    "casadi": Target(
        ".py", "Python module with a casadi.Function and its Jacobian; needs casadi",
        "every model, exactly", casadi_source,
    ),
    "c": Target(
        ".h", "C header: forces, and forces with their Jacobian; needs math.h",
        "every model, exactly; single precision with TIREFIT_SINGLE", c_source,
    ),
    "numpy": Target(
        ".py", "Python module with one function of arrays; needs numpy",
        "every model, exactly", numpy_source,
    ),
    "mujoco": Target(
        ".py", "Python module as for numpy, and its friction for mujoco.sysid",
        "every model, exactly; peak friction for sysid", mujoco_source,
    ),
    **PARAMETER_FILES,
}  # fmt: skip
"""Target -> how it is written."""


class Exported(NamedTuple):
    """What :func:`export` wrote.

    Attributes:
        path: the file.
        shape: how the tire behaves where simulators fail.
        notes: what was assumed, and what the file does not hold.
    """

    path: Path
    shape: Shape
    notes: tuple[str, ...]


def export(
    source,
    target: str,
    path: str | os.PathLike,
    *,
    front=None,
    rear=None,
    vehicle: str | os.PathLike | None = None,
    over: Mapping[str, tuple[float, float]] | None = None,
    values: Mapping[str, float] | None = None,
    convention: str = "iso-w",
    name: str | None = None,
    force: bool = False,
) -> Exported:
    """Write a tire as a file that another program reads or compiles.

    ``c``, ``casadi`` and ``numpy`` hold the model itself, operation by operation, so
    they give the forces of :func:`tirefit.predict` to rounding. The others are
    parameters of a simulator's own formula: converted by formula where it holds the
    tire, else refitted, with the largest miss in the file and in ``notes``.

    Args:
        source: a fit, a ``fit.json``, a ``.tir`` file, a tire, or the name of a model;
            None with ``front`` or ``rear``.
        target: a key of :data:`TARGETS`.
        path: the file to write.
        front, rear: tires of the axles, in place of ``source``.
        vehicle: a ``vehicle.toml``, for targets that hold a car.
        over: kappa, alpha [rad] and fz [N] of a refit, least and largest, in the signs
            of iso-w; what was measured by default.
        values: parameter values of a model or a ``.tir`` file; a fit has its own.
        convention: signs of the file's inputs and forces.
        name: of the function in the file; the file's own name by default.
        force: replace a file that is no export; write one that misses the tire by more
            than 5 % of its load.

    Returns:
        The file, and how the tire behaves at rest, at large slip and at twice the
        largest load; ``shape.sound`` is False where it jumps, is not finite, has wrong
        signs, or exceeds the ellipse of its pure forces.

    Raises:
        UsageError: unknown target, convention or parameter; values beside a fit; a name
            that no function can have; a file that cannot be written, or that is there
            and no export; a model that the target cannot hold; or data of the vehicle
            that are missing.
        DataError: the source cannot be read.

    Example:
        >>> import tempfile, jax
        >>> jax.config.update("jax_enable_x64", True)
        >>> done = export("brush", "numpy", tempfile.mkdtemp() + "/tire.py")
        >>> done.shape.sound
        True
    """
    path = Path(path)
    name = path.stem if name is None else name
    given = {"": source, "front": front, "rear": rear}
    given = {axle: one for axle, one in given.items() if one is not None}
    check(given, target, path, convention, name, force)
    kind = TARGETS[target]
    if isinstance(kind, Target) and (vehicle is not None or over or "" not in given):
        reason = f"{target} holds one tire as it is: no axles, vehicle or range"
        raise UsageError(InputProblem(reason, "leave them out, or see --list"))
    tires = {axle: tire_of(one, values) for axle, one in given.items()}
    first = f"{MARK}, tirefit {__version__}: "
    first += f"{' and '.join(tire.name for tire in tires.values())} for {target}"
    if isinstance(kind, ParameterFile):
        done = parameter_text(target, tires, path, first, vehicle, over, force)
        write_text_atomic(path, done.text)
        return Exported(path, done.shape, done.notes)
    (tire,) = tires.values()
    try:
        forces = tire.program(convention)
        shape = shape_of(tire, forces, convention)
        above = [first, *header(tire, forces, convention), *shape.sentences]
        draft = Draft(tire, forces, convention, one_line(above), name)
        text = kind.write(draft)
    except NotImplementedError as error:
        reason = f"{tire.name} cannot be written for {target}: {error}"
        remedy = "export another model, fitted to its curve by `tirefit convert`"
        raise UsageError(InputProblem(reason, remedy)) from None
    write_text_atomic(path, text)
    return Exported(path, shape, tire.notes)


def check(
    given: Mapping, target: str, path: Path, convention: str, name: str, force: bool
) -> None:
    """Raises UsageError for all that is wrong with a request, before the work.

    ``given``: the tires, under the name of their axle or under none.
    """
    problems = []
    for what, named, known in (
        ("--to", target, TARGETS), ("--convention", convention, CONVENTIONS),
    ):  # fmt: skip
        if named not in known:
            remedy = f"{did_you_mean(named, known)}valid: {', '.join(known)}"
            problems.append(InputProblem(f"{what}: {named!r} is not known", remedy))
    if not given or "" in given and len(given) > 1:
        remedy = "give one tire, or those of --front and --rear"
        problems.append(InputProblem("which tire is to be written?", remedy))
    if target in PARAMETER_FILES:
        if convention != SIGNS:
            reason = f"{target} has signs of its own, which no --convention changes"
            problems.append(InputProblem(reason, "leave --convention out"))
    elif not _function_name(name):
        remedy = "name the function with --name: letters, digits and _, no keyword"
        problems.append(InputProblem(f"{name!r} is no name of a function", remedy))
    files = [one for one in given.values() if isinstance(one, str | os.PathLike)]
    ending = TARGETS[target].ending if target in TARGETS else ""
    if unwritable := output_problems(path, files, ending):
        problems += unwritable
    elif path.exists() and not force and not _exported(path):
        reason = "the file is there and was not written by an export"
        remedy = "choose another file, or replace it with --force"
        problems.append(InputProblem(reason, remedy, str(path)))
    if problems:
        raise UsageError(problems)


def _function_name(name: str) -> bool:
    """Whether a function of C and Python may have a name."""
    plain = name.isidentifier() and name.isascii()
    return plain and not keyword.iskeyword(name) and name not in _TAKEN


def _exported(path: Path) -> bool:
    """Whether the first lines of a file say that an export wrote it."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return MARK in file.read(400)
    except OSError:
        return False
