"""A tire with the effects that a diagnosis names: :func:`extend`.

The effects change the tire by their formulas (:mod:`tirefit.diagnosis.effects`), with the
amplitudes of the document. A tire has only slip, load, speed, camber and pressure;
effects that need other quantities are only reported.
"""

import json
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat

from tirefit.diagnosis.effects import EFFECTS, NOISE_EFFECTS, Atom, NoiseEffect, effects_by_id
from tirefit.diagnosis.effects.state import (
    Covariates,
    arm_of,
    force_of_state,
    is_plain,
    null_state,
    peak_ratio,
    slip_of_state,
    slope_at_rest,
    with_offsets,
)
from tirefit.diagnosis.engine.decide import UNKNOWN
from tirefit.diagnosis.engine.fit import Fit
from tirefit.diagnosis.rows.covariates import column, slowest
from tirefit.diagnosis.rows.subject import Base
from tirefit.display import Record
from tirefit.door import RECORD, content_of, outrageous
from tirefit.models import AbstractTire, TireForces, TireInputs
from tirefit.params import check_values, specs, with_values
from tirefit.results import DataError, InputProblem, UsageError
from tirefit.settings import faults_in
from tirefit.slip import lateral_slip

SCHEMA = "tirefit.diagnosis/4"

_NO_LOAD = 1e-6
"""Share of the mean load below which laws of the load are constant, as powers of the load
have no value at zero."""

_CLAIM = {
    "none": "no effect",
    "unknown": "an unlisted effect",
    "incomplete": "exactly these effects and an unlisted one",
}
"""Status -> the claim that has the probability of the verdict; else exactly its effects."""

_OF_RUN = ("brisk", "cruise", "rise", "peak")  # covariates with one value for all rows


class Extension(NamedTuple):
    """The quantities to which the amplitudes of a file refer.

    Attributes:
        mode: slip that causes the forces: x, y or xy.
        variants: number of the formula of each fitted effect, by its id.
        load: mean load [N].
        at: median load [N] and speed [m/s].
        slowest: speed below which a wheel counts as standing [m/s].
        brisk, cruise, rise, peak: as in :class:`effects.state.Covariates`.
        used: largest force over load of the base fit.
        pressure: mean and range of the inflation pressure [Pa].
    """

    mode: Annotated[str, Field(pattern="^(x|y|xy)$")]
    variants: Mapping[str, int]
    load: PositiveFloat
    at: tuple[float, float]
    slowest: PositiveFloat
    brisk: PositiveFloat
    cruise: PositiveFloat
    rise: PositiveFloat
    peak: PositiveFloat
    used: PositiveFloat
    pressure: tuple[float, float]


def extension_of(base: Base, chosen: Fit) -> Extension:
    """The extension of a file, for the effects of a fitted set."""
    rows, prepared = base.design.rows, base.rows
    inflation = column(prepared.data, "pressure")
    first = {name: float(getattr(rows, name)[0]) for name in ("load", *_OF_RUN)}
    fz = np.asarray(prepared.inputs.fz)
    share = np.abs(np.asarray(rows.traction)[: prepared.n]) * first["load"] / fz
    return Extension(
        mode=prepared.mode,
        variants={base.atoms[k].effect.id: base.atoms[k].variant for k in chosen.atoms},
        at=(float(base.design.reference[0]), float(base.design.reference[1])),
        slowest=slowest(column(prepared.data, "v")),
        used=float(np.max(share)),
        pressure=(float(np.mean(inflation)), float(np.ptp(inflation))),
        **first,
    )


def _covariates(extension: Extension, inputs: TireInputs, force: Any) -> Covariates:
    """The quantities on which effects may depend, for one sample. Those that a tire does
    not have are None, so that an effect that uses them raises an error.

    Args:
        force: force of the base fit that the slip drives [N].
    """
    slip, across = inputs.sigma_x, jnp.tan(inputs.alpha)
    driven = across if extension.mode == "y" else slip
    mean, span = extension.pressure
    pressure = jnp.where(inputs.pressure == 0, mean, inputs.pressure)
    load = jnp.maximum(inputs.fz, _NO_LOAD * extension.load)
    share = force / (extension.used * load)
    # The added square keeps the size of the slip differentiable at zero.
    size = jnp.sqrt(slip**2 + across**2 + 1e-30)
    known = {name: getattr(extension, name) for name in _OF_RUN}
    known |= dict(
        fz=load / extension.load,
        load=extension.load,
        v=inputs.v,
        gamma=inputs.gamma,
        inflation=(pressure - mean) / span if span else 0.0,
        side=jnp.sign(driven),
        force=share,
        usage=jnp.abs(share),
        traction=force / extension.load,
        pace=jnp.maximum(jnp.abs(inputs.v), extension.slowest),
        sliding=jnp.abs(inputs.v * size / (1 + slip)),
    )
    absent: dict[str, Any] = dict.fromkeys(Covariates._fields)
    return Covariates(**absent | known)


class Extended(AbstractTire):
    """A tire with effects, in steady state.

    Attributes:
        tire: the tire with the parameters that were fitted beside the effects.
        effects: variants of effects, and their amplitudes.
        extension: what the amplitudes refer to.
        usual: forces of the base fit, for effects that follow them.
        peak: largest force over load of ``tire``.
    """

    tire: AbstractTire
    effects: tuple[tuple[Atom, float], ...] = eqx.field(static=True)
    extension: Extension = eqx.field(static=True)
    usual: Callable[..., Any] = eqx.field(static=True)
    peak: float = eqx.field(static=True)

    def __call__(self, inputs: TireInputs) -> TireForces:
        extension, tire, inputs = self.extension, self.tire, TireInputs(*map(jnp.asarray, inputs))
        usual, state = self.usual(inputs), null_state()
        rows = _covariates(extension, inputs, usual.fy if extension.mode == "y" else usual.fx)
        for atom, amplitude in self.effects:
            state = atom.change(state, amplitude, rows)
        along, across = inputs.sigma_x, jnp.tan(inputs.alpha)
        if extension.mode == "y":
            across = slip_of_state(state, across)
        else:
            along = slip_of_state(state, along)
        carrier = None
        if not is_plain(tire):
            at_rest = inputs._replace(sigma_x=0.0, alpha=0.0)
            carrier = slope_at_rest(tire, at_rest, extension.mode) / 2, self.peak, arm_of(tire)
        across = jnp.asarray(lateral_slip(across, along))
        extended = force_of_state(tire, carrier, state, along, across, inputs)
        plain: TireForces = tire(inputs)
        whole: Any = zip(
            ("fx", "fy", "mz"), with_offsets(extended, state, extension.mode), strict=True
        )
        return plain._replace(**{k: v for k, v in whole if getattr(plain, k) is not None})


class _Part(BaseModel):
    """A part of the document that is read and checked."""

    model_config = ConfigDict(allow_inf_nan=False)


class _Amplitude(_Part):
    value: float
    std: float
    unit: str


class _Candidate(_Part):
    effects: list[str]
    parameters: dict[str, _Amplitude]


class _Verdict(_Part):
    status: str
    effects: list[str]
    acts_like: list[str]
    probability: float
    also_possible: list[str]

    @property
    def helping(self) -> list[str]:
        """The effects of the extended model: causes, then those that act like one."""
        return [e for e in (*self.effects, *self.acts_like) if e != UNKNOWN]


class _Data(_Part):
    name: str
    sha256: str


class AnyDocument(_Part):
    """The parts of a diagnosis that the application of its effects needs."""

    data: _Data
    model: str
    simulator: dict[str, Any] | None
    verdict: _Verdict
    candidates: list[_Candidate]
    base_parameters: dict[str, float]
    extended_parameters: dict[str, float]

    @property
    def amplitudes(self) -> dict[str, _Amplitude]:
        """``effect: parameter`` -> amplitude in the fit of the effects that help."""
        helping = set(self.verdict.helping)
        return next((x.parameters for x in self.candidates if set(x.effects) == helping), {})


class Document(AnyDocument):
    """The same of rows of forces."""

    extension: Extension


Parsed = TypeVar("Parsed", bound=BaseModel)


def read_checked(
    source: Record | str | PathLike[str],
    kind: type[Parsed],
    name: str,
    command: str,
    schema: str = SCHEMA,
) -> Parsed:
    """The parts of a diagnosis, or of another result with a schema, or of its document.

    Args:
        kind: of the parts.
        name: of the document, for messages; ``command`` writes it.
        schema: that the document must name.

    Raises:
        DataError: no such file, no such document, or one of another version.
    """
    file = "" if isinstance(source, Record) else str(source)
    what = f"{name} of `{command}`"
    remedy = f"give {what}; run it again for an older file"
    try:
        if isinstance(source, Record):
            content = json.loads(source.to_json())
        else:
            content = json.loads(content_of(Path(source), RECORD, DataError, remedy))
        if not isinstance(content, dict) or content.get("schema") != schema:
            raise ValueError(f"its schema is not {schema}")
        if odd := outrageous(content, 0.0):
            raise ValueError(": ".join(odd))
        return kind.model_validate(content)
    except (ValueError, RecursionError) as error:
        raise DataError(InputProblem(f"not {what}: {faults_in(error)}", remedy, file)) from None


def read_document(source: Record | str | PathLike[str]) -> Document:
    """The document of a diagnosis of forces; raises DataError as :func:`read_checked`."""
    return read_checked(source, Document, "NAME.json", "tirefit diagnose")


class Report(NamedTuple):
    """A tire with effects, and sentences on the verdict and on each effect."""

    tire: AbstractTire  # with the effects that it can have
    bare: AbstractTire  # without them
    names: tuple[str, ...]  # of the effects that it holds
    sentences: tuple[str, ...]


def extend(tire: AbstractTire, name: str, document: Document, finish: Callable[..., Any]) -> Report:
    """A tire with the named effects of a diagnosis.

    Args:
        tire: the tire that was diagnosed; its parameters are replaced by those that were
            fitted together with the effects.
        name: of its model.
        finish: what is done to a tire before the effects change it.

    Raises:
        UsageError: the diagnosis is of another model, or of a simulator that is known
            by its forces alone; or its parameters are outside their bounds.
    """
    verdict, remedy = document.verdict, "diagnose the model, fit or .tir of this tire"
    known = specs(tire)
    columns = (document.simulator or {}).get("kind") == "columns"
    other = document.simulator is None and document.model != name
    if columns or other or not known.keys() >= document.extended_parameters.keys():
        what = "a simulator's columns" if columns else document.model
        reason = f"the diagnosis is for {what}, but the tire is a {name}"
        raise UsageError(InputProblem(reason, remedy))
    for values in (document.extended_parameters, document.base_parameters):
        check_values(tire, name, values)
    sentences = [
        f"diagnosis of {document.data.name} (sha256 {document.data.sha256[:12]}):"
        f" {verdict.status.replace('_', ' ')}, probability {verdict.probability:.2f} of"
        f" {_CLAIM.get(verdict.status, 'exactly these effects')}"
    ]
    if verdict.also_possible:
        others = ", ".join(verdict.also_possible)
        sentences.append(f"these data do not rule out {others} instead")
    held = []
    for effect in verdict.helping or verdict.effects:
        atom, sentence = _judged(effect, document)
        held += atom
        sentences.append(sentence)
    bare = finish(with_values(tire, document.extended_parameters))
    if not held:
        return Report(bare, bare, (), tuple(sentences))
    plain, extension = finish(with_values(tire, document.base_parameters)), document.extension
    reference = f"F_z0 = mean F_z = {extension.load:.5g} N and v0 = {extension.cruise:.4g} m/s"
    sentences.append(f"in these formulas {reference}")
    peak = float(peak_ratio(bare, *extension.at))
    extended = Extended(bare, tuple(held), extension, lambda inputs: plain(inputs), peak)
    names = tuple(atom.effect.id for atom, _ in held)
    return Report(extended, bare, names, tuple(sentences))


def _judged(id: str, document: Document) -> tuple[list[tuple[Atom, float]], str]:
    """The formula of an effect and its amplitude, if a tire can have it, and a sentence."""
    effect = effects_by_id((*EFFECTS, *NOISE_EFFECTS)).get(id)
    if effect is None or isinstance(effect, NoiseEffect):
        what = "of the noise" if effect else "not in the library of effects"
        what = "no listed effect is the likely cause" if id == UNKNOWN else what
        return [], f"not in the forces: {id}: {what}"
    extension, prefix = document.extension, f"{id}: "
    sizes = ((k, x) for k, x in document.amplitudes.items() if k.startswith(prefix))
    whole, size = next(sizes, (id, None))
    variant = extension.variants.get(id, -1)
    if size is None or variant not in range(len(effect.variants)):
        return [], f"not in the forces: {id}: it has no amplitude"
    atom, name = Atom(effect, variant), whole.removeprefix(prefix)
    unit = f" {size.unit.removeprefix('-').strip()}".rstrip()
    message = f"{id} {name} = {size.value:.5g} +- {size.std:.2g}{unit}"
    message += f": {effect.means} ({effect.formula})"
    if effect.of == "measurement":
        return [], f"of the measurement, not in the forces: {message}; {effect.remedy}"
    if effect.of != "tire":
        return [], f"not in the forces, of the {effect.of}: {message}"
    usual = TireInputs(0.01, 0.01, extension.load, extension.cruise)
    try:
        atom.change(null_state(), size.value, _covariates(extension, usual, extension.load))
    except TypeError:  # it uses a covariate that is None: no input of a tire
        return [], f"not in the forces: {message}"
    return [(atom, size.value)], f"in the forces: {message}"
