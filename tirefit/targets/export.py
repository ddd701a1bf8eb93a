"""A fitted tire as a file of another program: :func:`export`."""

import keyword
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tirefit import __version__
from tirefit.data.write import output_problems
from tirefit.files import write_texts
from tirefit.fitting.tir import TIR_SIGNS
from tirefit.results import InputProblem, UsageError, did_you_mean
from tirefit.slip import CONVENTIONS
from tirefit.targets.chrono import chrono_source, held_by_chrono
from tirefit.targets.code import (
    Draft,
    c_source,
    casadi_source,
    header,
    numpy_source,
)
from tirefit.targets.loss import check_loss
from tirefit.targets.shape import Shape, shape_of
from tirefit.targets.stablehlo import jax_source
from tirefit.targets.tir import held_as_tir, tir_source
from tirefit.targets.tire import Tire, tire_of

if TYPE_CHECKING:
    from tirefit.diagnosis.summary.result import Diagnosis

MARK = "written by tirefit export"
"""What the first line of every exported file says."""

_TAKEN = frozenset(
    "auto case char const default do double enum extern float goto inline int long"
    " register restrict short signed sizeof static struct switch typedef union unsigned"
    " void volatile np ca jax jnp base64".split()
)
"""Words of C that are none of Python, and what the Python files import."""

_NEW_LINE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
"""Characters that may end a line."""


class Target(NamedTuple):
    """A program that an export is for.

    Attributes:
        ending: of the file.
        what: what the file is, and what it needs.
        holds: the models that it holds, and how exactly.
        write: the text of the file, or of several by their endings.
        prepare: (tire, version of the Magic Formula, values of the wheel) -> the tire
            that the file holds; None where it holds every tire and has a function.
        beside: endings of other files that are written beside it.
    """

    ending: str
    what: str
    holds: str
    write: Callable[[Draft], str | dict[str, str]]
    prepare: Callable[..., Tire] | None = None
    beside: tuple[str, ...] = ()


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
    "jax": Target(
        ".py", "Python module with a compiled program (StableHLO) of arrays, for jit"
        " and grad; needs jax",
        "every model, exactly", jax_source,
    ),
    "tir": Target(
        ".tir", "tire property file, Magic Formula 5.2, 6.1 or 6.2 (--model)",
        "a Magic Formula, exactly in its own version; of a brush c_p a^2 and mu (needs"
        " --wheel radius=)", tir_source, held_as_tir,
    ),
    "chrono": Target(
        ".json", "tire of Project Chrono (Pac02Tire), with its .tir beside it; needs"
        " --wheel mass= ixx= iyy= vertical_stiffness= vertical_damping= width=, one"
        " each, as far as no .tir states them",
        "what a .tir of Magic Formula 5.2 holds", chrono_source, held_by_chrono,
        (".tir",),
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
    diagnosis: "Diagnosis | str | os.PathLike | None" = None,
    model: str | None = None,
    wheel: Mapping[str, float] | None = None,
    forces: Sequence[str] | str = (),
    convention: str = "iso-w",
    name: str | None = None,
    force: bool = False,
) -> Exported:
    """Write a tire as a file that another program reads or compiles.

    Source code holds the model itself, operation by operation, so it gives the forces
    of :func:`tirefit.predict` to rounding. ``notes`` say what other files miss.

    Args:
        source: a fit, a ``fit.json``, a ``.tir`` file, a tire, or the name of a model.
        target: a key of :data:`TARGETS`.
        path: the file to write.
        values: parameter values of a model or a ``.tir`` file; a fit has its own.
        diagnosis: of the same model, or its ``NAME.json``: the effects that it names
            change the tire where the target can hold them.
        forces: of source code, of fx, fy, mz, mx, my those that are wanted; all if
            empty. Fewer are computed faster.
        convention: signs of the file's inputs and forces.
        name: of the function in the file; the file's own name by default.
        model: version of the Magic Formula of a ``.tir``: ``mf52``, ``mf61``, ``mf62``.
        wheel: what a target needs beside the tire, in SI units, see :data:`TARGETS`.
        force: replace a file that is no export, and write one that misses the tire by
            more than :data:`~tirefit.targets.loss.MOST` of the load.

    Returns:
        The file, and how the tire behaves at rest, at large slip and at twice the
        largest load; ``shape.sound`` is False where it jumps, is not finite, has wrong
        signs, or exceeds the ellipse of its pure forces.

    Raises:
        UsageError: unknown target, convention or parameter; values beside a fit; a name
            that no function can have; a file that cannot be written, or that is there
            and no export; a model that the target cannot hold; or a diagnosis of
            another model.
        DataError: the source or the diagnosis cannot be read.

    Example:
        >>> import tempfile, jax
        >>> jax.config.update("jax_enable_x64", True)
        >>> done = export("brush", "numpy", tempfile.mkdtemp() + "/tire.py")
        >>> done.shape.sound
        True
    """
    path = Path(path)
    if name is None or target in TARGETS and TARGETS[target].prepare:
        name = path.stem
    check(source, target, path, convention, name, force, model, wheel, forces)
    tire, chosen = tire_of(source, values, diagnosis), TARGETS[target]
    if chosen.prepare is not None:
        held = chosen.prepare(tire, model, wheel or {})
        missed = check_loss(tire, held, target, force)
        tire = replace(held, notes=held.notes + missed)
    if forces:
        asked = forces.split(",") if isinstance(forces, str) else forces
        tire = replace(tire, asked=tuple(asked))
    first = f"{MARK}, tirefit {__version__}: {tire.name} for {target}"
    try:
        program = tire.program(convention)
        shape = shape_of(tire, program, convention)
        above = [first, *header(tire, program, convention), *shape.sentences]
        # A line of a file's name or text must not end the comment.
        above = [_NEW_LINE.sub(" ", line) for line in above]
        draft = Draft(tire, program, convention, above, name, wheel or {})
        text = chosen.write(draft)
    except NotImplementedError as error:
        reason = f"{tire.name} cannot be written for {target}: {error}"
        remedy = "export another model, fitted to its curve by `tirefit convert`"
        raise UsageError(InputProblem(reason, remedy)) from None
    texts = {chosen.ending: text} if isinstance(text, str) else text
    write_texts({path.with_suffix(end): each for end, each in texts.items()})
    return Exported(path, shape, tire.notes)


def check(
    source,
    target: str,
    path: Path,
    convention: str,
    name: str,
    force: bool,
    model: str | None = None,
    wheel: Mapping[str, float] | None = None,
    forces: Sequence[str] | str = (),
) -> None:
    """Raises UsageError for all that is wrong with a request, before the work."""
    problems = []
    for what, given, known in (
        ("--to", target, TARGETS), ("--convention", convention, CONVENTIONS),
    ):  # fmt: skip
        if given not in known:
            remedy = f"{did_you_mean(given, known)}valid: {', '.join(known)}"
            problems.append(InputProblem(f"{what}: {given!r} is not known", remedy))
    is_code = target not in TARGETS or TARGETS[target].prepare is None
    asked = {"--model": model, "--wheel": wheel}
    for option in [option for option, given in asked.items() if given and is_code]:
        reason = f"{option} with --to {target}, which has no use for it"
        problems.append(InputProblem(reason, "leave it out"))
    if not is_code and forces:
        reason = f"--forces with --to {target}, which has them all"
        problems.append(InputProblem(reason, "leave it out"))
    if not is_code and convention != TIR_SIGNS:
        reason = f"--convention {convention} with --to {target}"
        problems.append(InputProblem(reason, f"leave it out: it is {TIR_SIGNS}"))
    plain = name.isidentifier() and name.isascii() or not is_code
    if not plain or keyword.iskeyword(name) or name in _TAKEN:
        remedy = "name the function with --name: letters, digits and _, no keyword"
        problems.append(InputProblem(f"{name!r} is no name of a function", remedy))
    inputs = [source] if isinstance(source, str | os.PathLike) else []
    ending = TARGETS[target].ending if target in TARGETS else ""
    others = TARGETS[target].beside if target in TARGETS else ()
    for one, end in [(path, ending), *((path.with_suffix(e), e) for e in others)]:
        if unwritable := output_problems(one, inputs, end):
            problems += unwritable
        elif one.exists() and not force and not _exported(one):
            reason = "the file is there and was not written by an export"
            remedy = "choose another file, or replace it with --force"
            problems.append(InputProblem(reason, remedy, str(one)))
    if problems:
        raise UsageError(problems)


def _exported(path: Path) -> bool:
    """Whether the first lines of a file say that an export wrote it."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return MARK in file.read(400)
    except OSError:
        return False
