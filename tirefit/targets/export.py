"""Export a fitted tire as a file of another program: :func:`export`."""

import builtins
import keyword
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

from tirefit import __version__
from tirefit.data.write import output_problems
from tirefit.display import Record
from tirefit.door import UNSEALED, replaced_inputs, sealed_text, unsealed
from tirefit.files import write_texts
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.tir import TIR_SIGNS
from tirefit.results import DataError, InputProblem, Outcome, UsageError, unknown_names
from tirefit.slip import CONVENTIONS
from tirefit.targets import code
from tirefit.targets.autoware import AUTOWARE, CarFile
from tirefit.targets.parameters import PARAMETER_FILES, ParameterFile, one_line, parameter_text
from tirefit.targets.refit import check_loss, over_problems
from tirefit.targets.shape import Shape, shape_of
from tirefit.targets.tir import chrono_source, held_as_tir, held_by_chrono, tir_source
from tirefit.targets.tire import Tire, tire_of

if TYPE_CHECKING:
    from tirefit.diagnosis.summary.result import Diagnosis
    from tirefit.vehicle.trajectory import TrajectoryFit


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", re.ASCII)
"""CasADi and C++ reserve two underscores in a row, C and Python one at the beginning. One at
the end and that of ``_jacobian`` would be two in a row."""

_C_NAMES = frozenset(
    name
    for line in Path(__file__).with_name("c_names.txt").read_text("ascii").splitlines()
    if not line.startswith("#")
    for name in line.split()
)
"""Keywords and macros of C and C++, and names in math.h, which the file includes."""

_IN_FILES = frozenset("np ca jax jnp base64 null jac hess tirefit_real sysid_parameters".split())
"""Names with another meaning in exported files; CasADi reserves null, jac and hess."""


class Target(NamedTuple):
    """A program for which tires are exported."""

    ending: str  # of the file
    what: str  # description of the file, with the data it needs
    holds: str  # the models that it holds, and how exactly
    write: Callable[[code.Draft], str | dict[str, str]]
    """The text of the file, or of several by their endings."""
    prepare: Callable[..., Tire] | None = None
    """(tire, version of the Magic Formula, values of the wheel) -> the tire in the file; None if
    it holds every tire and has a function."""
    beside: tuple[str, ...] = ()  # endings of other files that are written beside it


TARGETS: dict[str, Target | ParameterFile | CarFile] = {
    "casadi": Target(
        ".py", "Python module with a casadi.Function and its Jacobian; needs casadi",
        "every model, exactly", code.casadi_source,
    ),
    "c": Target(
        ".h", "C header: forces, and forces with their Jacobian; needs math.h",
        "every model, exactly; single precision with TIREFIT_SINGLE", code.c_source,
    ),
    "numpy": Target(
        ".py", "Python module with one function of arrays; needs numpy",
        "every model, exactly", code.numpy_source,
    ),
    "jax": Target(
        ".py", "Python module with one function of arrays, for jit and grad; needs jax",
        "every model, exactly", code.jax_source,
    ),
    "tir": Target(
        ".tir", "tire property file, Magic Formula 5.2, 6.1 or 6.2 (--model)",
        "a Magic Formula, exactly in its own version; of a brush c_p a^2 and mu (needs"
        " --wheel radius=)", tir_source, held_as_tir,
    ),
    "chrono": Target(
        ".json", "tire of Project Chrono (Pac02Tire), with its .tir beside it; needs"
        " --wheel mass= ixx= iyy= vertical_stiffness= vertical_damping= width=, one each",
        "what a .tir of Magic Formula 5.2 holds", chrono_source, held_by_chrono,
        (".tir",),
    ),
    "mujoco": Target(
        ".py", "Python module as for numpy, and its friction for mujoco.sysid",
        "every model, exactly; peak friction for sysid", code.mujoco_source,
    ),
    **PARAMETER_FILES,
    "autoware": AUTOWARE,
}  # fmt: skip
"""Name of a target -> its record."""


@dataclass(frozen=True)
class Exported(Record):
    """The result of :func:`export`."""

    text_by: ClassVar[str] = "tirefit.report.records:export_text"
    plot_by: ClassVar[str] = "tirefit.report.records:export_figure"
    target: str  # the key of :data:`TARGETS`
    path: Path  # the file
    shape: Shape  # how the tire behaves where simulators fail
    notes: tuple[str, ...]  # what was assumed, and what the file does not hold
    texts: Mapping[str, str] = field(repr=False)  # file name -> content

    @property
    def limits(self) -> dict[Outcome, str]:
        """The outcome of a failed check of the tire's forces -> its text, empty if none fails."""
        failed = "; ".join(self.shape.failed)
        return {Outcome.UNSOUND: f"{Outcome.UNSOUND.message}: {failed}" if failed else ""}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Failed checks, and those of ``notes`` that are warnings."""
        messages = (n.removeprefix("warning: ") for n in self.notes if n.startswith("warning: "))
        return (*super().warnings, *messages)

    def to_dict(self) -> dict[str, Any]:
        """Target, files, checks and notes."""
        return {
            "target": self.target,
            "path": str(self.path),
            "files": [*self.texts],
            "sound": self.shape.sound,
            "checks": [*self.shape.sentences],
            "notes": [*self.notes],
        }

    def files(self, name: str = "") -> Mapping[str, str]:
        """The exported files by name."""
        return self.texts


def export(
    source: "TireLike | TrajectoryFit | Diagnosis | None",
    target: str,
    path: str | os.PathLike[str],
    *,
    front: TireLike | None = None,
    rear: TireLike | None = None,
    vehicle: str | os.PathLike[str] | None = None,
    over: Mapping[str, tuple[float, float]] | None = None,
    values: Mapping[str, float] | None = None,
    diagnosis: "Diagnosis | str | os.PathLike[str] | None" = None,
    model: str | None = None,
    wheel: Mapping[str, float] | None = None,
    forces: Sequence[str] | str = (),
    convention: str = "iso-w",
    name: str | None = None,
    force: bool = False,
) -> Exported:
    """Write a tire as a file that another program reads or compiles.

    Source code contains the model itself, so it gives the forces of
    :func:`tirefit.predict` to rounding. Parameters of the formula of a simulator are
    converted exactly if it can represent the tire, else refitted.

    Args:
        source: a fit, a ``fit.json``, a ``.tir`` file, a tire, or the name of a model;
            None with ``front`` or ``rear``. For ``autoware``: a fit by trajectory or its
            ``trajectory.json``, a diagnosis of a car or its ``vehicle_diagnosis.json``.
        target: a key of :data:`TARGETS`.
        path: the file to write.
        front: tire of the front axle; it and ``rear`` replace ``source``.
        rear: tire of the rear axle.
        vehicle: a ``vehicle.toml``, for targets that describe a car.
        over: kappa, alpha [rad] and fz [N] of a refit, least and largest, in the signs
            of iso-w; what was measured by default.
        values: parameter values of a model or a ``.tir`` file; a fit has its own.
        diagnosis: of the same model, or its ``NAME.json``: its named effects change the
            tire if the target can represent them.
        forces: for source code, those of fx, fy, mz, mx, my to write; all if empty.
            Fewer forces are computed faster.
        convention: signs of inputs and forces in the file.
        name: of the function in the file; the file name by default.
        model: version of the Magic Formula of a ``.tir``: ``mf52``, ``mf61``, ``mf62``.
        wheel: data that a target needs in addition to the tire, in SI units, see :data:`TARGETS`.
        force: replace a file that is not an unchanged export, and write one that misses
            the tire by more than :data:`~tirefit.targets.refit.MOST` of the load, or that
            uses the tire far from where it was measured.

    Returns:
        The file, its error, and checks of the tire; ``shape.sound`` is False if a force
        jumps, is not finite, has a wrong sign, or exceeds the friction ellipse.

    Raises:
        UsageError: unknown names, or options that the target does not use; a file that
            cannot be written, or that exists and is no unchanged export; a model that the target
            cannot represent; a diagnosis of another model; missing data of the car.
        DataError: the source or the diagnosis cannot be read, or would be replaced.

    Example:
        >>> done = export("brush", "numpy", folder / "tire.py")
        >>> done.shape.sound
        True
    """
    path = Path(path)
    axles = {"": source, "front": front, "rear": rear}
    given = {axle: tire for axle, tire in axles.items() if tire is not None}
    problems = unknown_names("--to", [target], TARGETS)
    problems += unknown_names("--convention", [convention], CONVENTIONS)
    if not given or "" in given and len(given) > 1:
        remedy = "give one tire, or those of --front and --rear"
        problems.append(InputProblem("no tire is given", remedy))
    chosen = TARGETS.get(target)
    single = chosen if isinstance(chosen, Target) else None
    of_car = isinstance(chosen, CarFile)
    is_code = chosen is None or single is not None and single.prepare is None
    name = name if name is not None and is_code else path.stem
    problems += over_problems(over or {})
    for option, value, is_used in (
        ("--model", model, single and single.prepare),
        ("--wheel", wheel, single and single.prepare),
        ("--convention", convention != TIR_SIGNS, is_code),
        ("--forces", forces, is_code),
        ("--front, --rear, --vehicle or --over", vehicle or over or "" not in given, not single),
        ("--over, --set or --diagnosis", over or values or diagnosis, not of_car),
    ):
        if chosen and value and not is_used:
            reason = f"{option} with --to {target}, which does not use it"
            problems.append(InputProblem(reason, "leave it out, or see --list"))
    if is_code and (why := reserved(name)):
        reason = f"{name!r} is not valid as a name of a function: {why}"
        problems.append(InputProblem(reason, "name the function with --name, as in --name my_tire"))
    made = {path: chosen.ending if chosen else ""}
    made |= {path.with_suffix(end): end for end in (single.beside if single else ())}
    for file, ending in made.items():
        faults = output_problems(file, ending)
        if not (faults or force):
            faults = unsealed(file, "choose another file, or replace it with --force")
        problems += faults
    UsageError.raise_for(problems)
    assert chosen is not None
    read = {"the tire": given.values(), "--vehicle": [vehicle], "--diagnosis": [diagnosis]}
    DataError.raise_for(replaced_inputs([*made], read))
    first = f"written by tirefit export, {UNSEALED}, tirefit {__version__}: "
    if isinstance(chosen, CarFile):
        text, notes = chosen.write(source, vehicle, f"{first}a car for {target}")
        return _written(target, path, Shape((), (), {}), notes, {path: text})
    tires = {axle: tire_of(cast(TireLike, tire), values, diagnosis) for axle, tire in given.items()}
    first += f"{' and '.join(tire.name for tire in tires.values())} for {target}"
    if isinstance(chosen, ParameterFile):
        parts = parameter_text(target, tires, path, first, vehicle, over, force)
        return _written(target, path, *parts[1:], {path: parts[0]})
    (tire,) = tires.values()
    if chosen.prepare is not None:
        held = chosen.prepare(tire, model, wheel or {})
        missed = check_loss(tire, held, target, force)
        tire = replace(held, notes=held.notes + missed)
    if forces:
        asked = forces.split(",") if isinstance(forces, str) else forces
        tire = replace(tire, asked=tuple(asked))
    text, shape = _drafted(target, tire, convention, name, wheel or {}, first)
    texts = {chosen.ending: text} if isinstance(text, str) else text
    files = {path.with_suffix(end): each for end, each in texts.items()}
    return _written(target, path, shape, tire.notes, files)


def reserved(name: str) -> str:
    """Why a function in an exported file cannot have this name; empty if it can.

    The function is written into C headers, which include ``math.h``, and Python modules.
    """
    if not _NAME.fullmatch(name):
        return "it is not letters and digits, with single underscores between them"
    if not re.search("[a-z]", name):
        return "it has no lower-case letter, like a macro of C"
    stem = re.sub("(f[0-9]+x?|f|l)$", "", name)  # sinf, sinl and sinf64x are of the type
    if {name, stem} & _C_NAMES:
        return "C has this name"
    if keyword.iskeyword(name) or hasattr(builtins, name) or name in _IN_FILES:
        return "Python or the exported file has this name"
    return ""


def _drafted(
    target: str, tire: Tire, convention: str, name: str, wheel: Mapping[str, float], first: str
) -> tuple[str | dict[str, str], Shape]:
    """The text of one tire, or of several files by their endings, and its shape."""
    try:
        program = tire.program(convention)
        shape = shape_of(tire, program, convention)
        above = [first, *code.header(tire, program, convention), *shape.sentences]
        chosen = TARGETS[target]
        assert isinstance(chosen, Target)
        draft = code.Draft(tire, program, convention, one_line(above), name, shape.curves, wheel)
        return chosen.write(draft), shape
    except NotImplementedError as error:
        reason = f"{tire.name} cannot be written for {target}: {error}"
        remedy = "export another model, fitted to its curve by `tirefit convert`"
        raise UsageError(InputProblem(reason, remedy)) from None


def _written(
    target: str, path: Path, shape: Shape, notes: tuple[str, ...], texts: Mapping[Path, str]
) -> Exported:
    texts = {path: sealed_text(text) for path, text in texts.items()}
    write_texts(texts)
    named = {path.name: text for path, text in texts.items()}
    # Notes on both axles are often the same.
    return Exported(target, path, shape, tuple(dict.fromkeys(notes)), named)
