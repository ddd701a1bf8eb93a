"""A fitted tire as a file of another program: :func:`export`."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tirefit.files import write_text_atomic
from tirefit.results import InputProblem, UsageError, did_you_mean
from tirefit.slip import CONVENTIONS
from tirefit.targets.code import c_source, casadi_source, header, numpy_source
from tirefit.targets.program import Program
from tirefit.targets.shape import Shape, shape_of
from tirefit.targets.tire import Tire, tire_of

MARK = "written by tirefit export"
"""What the first line of every exported file says."""


class Target(NamedTuple):
    """A program that an export is for.

    Attributes:
        ending: of the file.
        what: what the file is, and what it needs.
        holds: which models it holds, and how exactly.
        write: of the tire, its forces as a program, the convention, the lines above and
            the name of the function, to the text of the file.
    """

    ending: str
    what: str
    holds: str
    write: Callable[[Tire, Program, str, Sequence[str], str], str]


TARGETS: dict[str, Target] = {
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
    values: Mapping[str, float] | None = None,
    convention: str = "iso-w",
    name: str | None = None,
    force: bool = False,
) -> Exported:
    """Write a tire as a file that another program reads or compiles.

    The file holds the model itself, operation by operation, so it gives the forces of
    :func:`tirefit.predict` to rounding.

    Args:
        source: a fit, a ``fit.json``, a ``.tir`` file, a tire, or the name of a model.
        target: a key of :data:`TARGETS`.
        path: the file to write.
        values: parameter values of a named model or a ``.tir`` file.
        convention: signs of the file's inputs and forces.
        name: of the function in the file; the file's own name by default.
        force: replace a file that is no export.

    Returns:
        The file, and how the tire behaves at rest, at large slip and at twice the
        largest load; ``shape.sound`` is False where it jumps, is not finite, has wrong
        signs, or exceeds the ellipse of its pure forces.

    Raises:
        UsageError: unknown target, convention or parameter; a name that is none; or a
            file that is there and no export.
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
    check(target, path, convention, name, force)
    tire = tire_of(source, values)
    from tirefit import __version__

    try:
        forces = tire.program(convention)
        shape = shape_of(tire, forces, convention)
        first = f"{MARK}, tirefit {__version__}: {tire.name} for {target}"
        above = [first, *header(tire, forces, convention), *shape.sentences]
        text = TARGETS[target].write(tire, forces, convention, above, name)
    except NotImplementedError as error:
        reason = f"{tire.name} uses an operation that {target} lacks: {error}"
        remedy = "export another model, fitted to its curve by `tirefit convert`"
        raise UsageError(InputProblem(reason, remedy)) from None
    write_text_atomic(path, text)
    return Exported(path, shape, tire.notes)


def check(target: str, path: Path, convention: str, name: str, force: bool) -> None:
    """Raises UsageError for all that is wrong with a request, before the work."""
    problems = []
    for what, given, known in (
        ("--to", target, TARGETS), ("--convention", convention, CONVENTIONS),
    ):  # fmt: skip
        if given not in known:
            remedy = f"{did_you_mean(given, known)}valid: {', '.join(known)}"
            problems.append(InputProblem(f"{what}: {given!r} is not known", remedy))
    if not (name.isidentifier() and name.isascii()):
        remedy = "name the function with --name: letters, digits and _"
        problems.append(InputProblem(f"{name!r} is no name of a function", remedy))
    if path.exists() and not force and not _exported(path):
        reason = "the file is there and was not written by an export"
        remedy = "choose another file, or replace it with --force"
        problems.append(InputProblem(reason, remedy, str(path)))
    if not path.parent.is_dir():
        reason = f"no folder {path.parent}"
        problems.append(InputProblem(reason, "make it first", str(path)))
    if problems:
        raise UsageError(problems)


def _exported(path: Path) -> bool:
    """Whether the first lines of a file say that an export wrote it."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return MARK in file.read(400)
    except OSError:
        return False
