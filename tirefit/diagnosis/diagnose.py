"""Diagnose one file: the noise, the place of the gap, its effects, the closure, and what
to measure next."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from tirefit.compiled import release_programs
from tirefit.data.accept import DataLike, as_data
from tirefit.data.far import without_far
from tirefit.data.read import require
from tirefit.data.table import TireData
from tirefit.diagnosis.effects import EFFECTS, Effect
from tirefit.diagnosis.effects.record import Atom
from tirefit.diagnosis.engine.search import searched
from tirefit.diagnosis.rows.prepared import Prepared, prepare, thinned
from tirefit.diagnosis.rows.rig import Rig, load_rig, unfit
from tirefit.diagnosis.rows.simulator import (
    STAND_INS,
    GivenSimulator,
    given_simulator,
    simulator_at,
)
from tirefit.diagnosis.rows.subject import fit_base, shown_slip_noise, with_noise
from tirefit.diagnosis.summary.case import Case, Untestable
from tirefit.diagnosis.summary.document import document_of
from tirefit.diagnosis.summary.readings import with_readings
from tirefit.diagnosis.summary.result import Diagnosis, Settings
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.problem.build import find_model
from tirefit.models import modelled
from tirefit.models.mf import MAGIC_FORMULAS
from tirefit.params import Values
from tirefit.precision import require_x64
from tirefit.results import InputProblem, UsageError, unknown_names

_MOST_ROWS = 6000
"""Number of rows, evenly spread, on which the search runs; the verdict uses all rows."""


def diagnose(
    data: DataLike,
    model: str | None = None,
    *,
    sim: TireLike | GivenSimulator | Mapping[str, Values] | Values | bool | None = None,
    signs: str | None = None,
    rig: Rig | str | PathLike[str] | None = None,
    forces: str | Sequence[str] | None = None,
    effects: Sequence[Effect] | None = None,
    without: str | Sequence[str] = (),
    holdout: DataLike | Sequence[DataLike] | None = (),
    seed: int = 0,
) -> Diagnosis:
    """Find the effects that a model lacks, and how far the gap to the data shrinks.

    ``print(found)`` shows one screen; ``found.plot()`` draws it.

    Args:
        data: a result of ``tirefit.read``, or data that it reads with its defaults: a
            path, a frame, a mapping of column -> (n,) array. A file that declares no
            convention is read in that of a file ``sim``.
        model: name of the base model, the brush by default; a whole Magic Formula
            (``mf52``, ``mf61``, ``mf62``) is fitted in stages, then not changed.
        sim: a simulator instead of a fit of ``model``: a tire model with its values, a fit, a
            ``fit.json`` or ``.tir`` file, True for the columns ``fx_sim``, ``fy_sim``, ``mz_sim``
            of the data, or arrays (n,) by channel, in canonical signs. If only its forces are
            known, a brush fitted to them, or mf61 if the brush does not follow them closely, is
            used for the changes of a hypothesis; ``model`` then describes the measured forces.
        signs: convention, a key of ``slip.CONVENTIONS``, of the ``.tir`` file ``sim`` ("iso-w" if
            None), or of the columns ``fx_sim``, ... (that of the data if None).
        rig: known properties (noise, radius, inertia), or a path of ``rig.toml``.
        forces: those of fx, fy, mz to diagnose; None for all that were measured.
        effects: the library to search, :data:`EFFECTS` if None; you may add to it.
        without: ids of effects that are not looked for.
        holdout: data of the same kinds, or a list of such, to check closure on.
        seed: of the simulated null distributions and bootstraps.

    Returns:
        ``verdict.effects`` are the likely causes, ``verdict.acts_like`` other effects that predict
        data left out better, and ``verdict.each`` has for both the probability that it or a twin is
        the cause, in a world that also holds effects which the library does not list; the share
        of the gap that it closes on data left out; and its twins: effects that these data
        cannot distinguish from it. ``verdict.sizes`` has the size of each by load, speed,
        slip, time and run. ``verdict.left`` describes the remainder, ``ladder`` the rms on
        data left out with one effect after the other. ``verdict.status`` is

        - ``none``: no gap beyond the noise;
        - ``named``: effects are named, and an unlisted one is unlikely;
        - ``cannot_tell``: the same, but a named effect has twins;
        - ``incomplete``: effects are named, and an unlisted one is probably present;
        - ``unknown``: there is a gap, and no listed effect is its likely cause.

    Raises:
        UsageError: an unknown model, force, or effect to leave out; an argument of
            another type; or 32-bit floats in use.
        DataError: no force with a slip that varies, no load, too few rows, no simulated
            forces, simulated ones that no tire follows, ``data`` held out too.

    The example is a brush whose slip sensor is off by 0.006.

    Example:
        >>> slip = np.tile(np.linspace(-0.2, 0.2, 32), 3)
        >>> load = np.repeat([2000.0, 4000.0, 6000.0], 32)
        >>> true = {"sigma_x": slip + 0.006, "fz": load}
        >>> force = predict("brush", true, {"cpa2": 5e4, "mu": 0.9})["fx"]
        >>> force = force + np.random.default_rng(1).normal(0, 20, len(slip))
        >>> measured = {"sigma_x": slip, "fz": load, "fx": force}
        >>> names = ("slip_offset", "force_offset", "load_friction")
        >>> few = [effect for effect in EFFECTS if effect.id in names]
        >>> found = diagnose(measured, rig=Rig(noise={"fx": 20.0}), effects=few)
        >>> str(found.status), str(found.verdict.status), found.verdict.effects
        ('ok', 'named', ('slip_offset',))
    """
    require_x64("a diagnosis")
    release_programs()
    effects = the_effects(EFFECTS if effects is None else effects)
    model, without = a_model(model), names(without, "without")
    asked = None if forces is None else names(forces, "forces")
    if isinstance(sim, str | PathLike):
        sim = simulator_at(str(sim), signs=signs)
    otherwise = sim.otherwise if isinstance(sim, GivenSimulator) else None
    data = as_data(data, otherwise=otherwise)
    several: Any = holdout if isinstance(holdout, list | tuple) else [holdout]
    others = [as_data(x, otherwise=otherwise) for x in several if x is not None]
    rig, generator = a_rig(rig), np.random.default_rng(a_seed(seed))
    _are_others(data, others)
    data, others = without_far(data), [without_far(other) for other in others]
    ids = sorted(effect.id for effect in effects)
    UsageError.raise_for(unknown_names("--without", sorted({*without}), ids))
    is_fitted = sim is None
    if model in MAGIC_FORMULAS and is_fitted:
        # Its coefficients are fitted to all rows; a hypothesis adapts scaling factors.
        sim = fit_magic_formula(data, model)
    plain = STAND_INS[0] if model is None else model
    given, channels = None, modelled(MAGIC_FORMULAS.get(plain) or find_model(plain))
    gives = channels
    if sim is not None:
        given = given_simulator(sim, data, signs)
        data, others = given.beside(data), [given.beside(x, True) for x in others]
        gives = given.channels(data, channels)
        channels = channels if given.tire is None else ()
    data = data.in_order()  # the order of rows may change the course of a search
    if asked is not None:
        gives = _asked_for(asked, data, gives, channels)
    library = tuple(effect for effect in effects if effect.id not in without)
    settings = Settings(
        rig=rig,
        effects=tuple(effect.id for effect in library),
        forces=asked,
        holdout=tuple(other.source.sha256 for other in others),
    )
    # One thread: the matrices are too small for two, and another order of summation
    # changes last digits, which can change the course of a search.
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        whole = prepare(data, rig, gives)
        form = STAND_INS[0] if plain in MAGIC_FORMULAS else plain
        some = thinned(whole, _MOST_ROWS)
        if (shown := shown_slip_noise(some, form, effects, rig)) is not None:
            some = thinned(whole := prepare(data, rig, gives, shown), _MOST_ROWS)
        case = studied(some, model, rig, effects, without, given)
        name, simulated = plain, case.base.simulator
        if simulated is not None:
            given = simulated.given
            name = simulated.stand_in if given.tire is None else given.source
        document = document_of(case, whole, settings, library, others, generator, name, seed)
        if document.simulator is None or is_fitted:
            return document

        def study(rows: Prepared, rig: Rig) -> Case:
            return studied(rows, form, rig, effects, without)

        return with_readings(document, case, some, rig, form, study)


# --- arguments: a single value counts as a list of one; all raise UsageError ----------


def names(given: object, argument: str) -> tuple[str, ...]:
    """Names as a tuple; a single text is one name."""
    several = (given,) if isinstance(given, str) else given
    if isinstance(several, Iterable):
        several = tuple(several)
        if all(isinstance(name, str) for name in several):
            return several
    raise UsageError(f"{argument} = {given!r}", "give a name, or several")


def the_effects(given: object) -> tuple[Effect, ...]:
    """Effects to search, at least one."""
    several = tuple(given) if isinstance(given, Iterable) else ()
    if several and all(isinstance(effect, Effect) for effect in several):
        return several
    reason = f"effects = {given!r}" if several else "effects: none to search"
    remedy = "leave the argument out for all of the library, or give Effect records: "
    remedy += "(*EFFECTS, mine) adds one, without=... leaves single ones out"
    raise UsageError(reason, remedy)


def a_model(given: object) -> str | None:
    """Name of a model, or none."""
    if given is None or isinstance(given, str):
        return given
    remedy = "give a model's name; a tire model with its values is a simulator: sim=..."
    raise UsageError(f"model is of type {type(given).__name__}", remedy)


def a_rig(given: object) -> Rig:
    """The rig: None, a record of it, or a file ``rig.toml``."""
    if given is None or isinstance(given, Rig):
        return given or Rig()
    if isinstance(given, str | PathLike):
        return load_rig(str(given))
    remedy = "give a Rig(...), or the path of a rig.toml"
    raise UsageError(f"rig is of type {type(given).__name__}", remedy)


def a_seed(given: object) -> int:
    """The seed of all random numbers."""
    if isinstance(given, int | np.integer) and 0 <= given < 2**32:
        return int(given)
    raise UsageError(f"seed = {given!r}", "give a whole number from 0 to 2^32 - 1")


def _are_others(data: TireData, holdout: Sequence[TireData]) -> None:
    """Raises DataError if held-out rows are among those that are diagnosed."""
    for other in holdout:
        source = other.source.sha256
        same = source and source == data.source.sha256 and len(other) == len(data)
        if (same or other.columns is data.columns) and np.any(other.used & data.used):
            reason = "the held-out data are those that are diagnosed"
            remedy = "give other data with --holdout, or none: parts are then left out"
            raise unfit(other, reason, remedy)


def _asked_for(
    forces: Sequence[str], data: TireData, gives: Sequence[str], in_columns: Sequence[str]
) -> tuple[str, ...]:
    """The forces to diagnose among those of the model; ``in_columns`` are the simulated
    columns, if the simulator is given by columns."""
    problems = []
    for name in (name for name in forces if name not in gives):
        reason, remedy = f"the model gives no {name}", f"it gives {', '.join(gives)}"
        if name in in_columns:
            reason = f"the simulated {name} is missing: there is no column {name}_sim"
            remedy = f"add it, or diagnose only {' or '.join(gives)}"
        problems.append(InputProblem(reason, remedy))
    UsageError.raise_for(problems)
    require(data, forces, "a diagnosis of them")
    return tuple(name for name in gives if name in forces)


def _testable(
    prepared: Prepared, atoms: tuple[Atom, ...], without: tuple[Any, ...]
) -> tuple[list[int], dict[str, list[str]]]:
    """Atoms that the data can show, and the missing needs of the other effects."""
    possible, missing = [], {}
    for k, atom in enumerate(atoms):
        effect = atom.effect
        if effect.id in without:
            continue
        lacks = [need for need in effect.needs if need not in prepared.has]
        if effect.channels and not set(effect.channels) & set(prepared.channels):
            lacks += list(effect.channels)
        if lacks:
            missing[effect.id] = lacks
        else:
            possible.append(k)
    return possible, missing


def studied(
    prepared: Prepared,
    model: str | None,
    rig: Rig,
    effects: tuple[Effect, ...],
    without: tuple[Any, ...],
    given: GivenSimulator | None = None,
) -> Case:
    """Noise, search and verdict of prepared rows; arguments as in :func:`diagnose`."""
    base = fit_base(prepared, model, effects, rig, given)
    testable, lacks = _testable(prepared, base.atoms, without)
    finite = np.asarray(np.isfinite(base.at_null.columns).all(axis=0))
    endless = {base.atoms[k].effect for k in testable if not finite[k]}
    if wrong := sorted(effect.id for effect in endless if effect not in EFFECTS):
        reason = f"effect {wrong[0]!r}: its change at amplitude 0 is not finite"
        remedy = "give a change that is smooth there and finite for all rows"
        raise UsageError(reason, remedy)
    if endless:  # at an angle of 90 degrees the sliding speed is infinite
        rest = tuple(effect for effect in effects if effect not in endless)
        case = studied(prepared, model, rig, rest, without, given)
        left = (Untestable(effect.id, ("finite slips",)) for effect in effects if effect in endless)
        return replace(case, untestable=(*case.untestable, *left))
    base = replace(base, testable=tuple(testable))
    search = searched(base)
    # The remainder of the best set shows the noise better than that of no effect.
    best = search.ranked[0]
    amplitudes = base.amplitudes(best.atoms, best.amplitude)
    judged = with_noise(base, rig, best.z, amplitudes, outliers=True)
    for channel, old in base.noise.items():
        new = judged.noise[channel]
        level = np.median(new.std) / np.median(old.std) * np.sqrt(new.inflation / old.inflation)
        # Search again for a change of the noise level by a tenth, or of the excluded rows.
        if abs(np.log(level)) > 0.1 or np.any(new.outlier != old.outlier):
            return Case.of(searched(judged), lacks)
    return Case.of(search, lacks)
