"""The result of a diagnosis (:class:`Diagnosis`): ``NAME.json``, whose keys are the fields of
these records, and ``NAME.rows.csv``.

Forces are in N, moments in N m, slips without unit, angles in rad; ids of effects are
those of :data:`tirefit.diagnosis.effects.EFFECTS`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from tirefit.data.records import FileRecord, Row, frame
from tirefit.data.table import TireData
from tirefit.data.write import csv_text, to_convention
from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.engine.decide import NOT_WRITTEN, UNKNOWN, Verdict
from tirefit.diagnosis.engine.left_out import Ladder, SizeByGroup
from tirefit.diagnosis.extended import SCHEMA
from tirefit.diagnosis.rows.rig import Rig, SlipCheck
from tirefit.diagnosis.rows.runs import RunOffsets
from tirefit.diagnosis.rows.structure import Structure
from tirefit.diagnosis.summary.case import Untestable
from tirefit.diagnosis.summary.views import Comparison, DataSummary, Region, Shape
from tirefit.display import ByName, Record
from tirefit.files import json_safe
from tirefit.models import MODELS
from tirefit.params import specs
from tirefit.results import Outcome

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, kw_only=True)
class NoiseSummary:
    """Standard deviations of the noise."""

    forces: Mapping[str, float]  # of each channel, median over the rows
    slip_name: str = ""  # empty for a car, whose slips are not measured
    slip: float = 0.0
    slip_source: str = ""
    source: str
    flags: tuple[str, ...] = ()
    inflation: float  # rows per independent row
    outliers: int = 0  # number of excluded rows
    excess: float = 1.0  # over the stated noise, 1 where none was stated

    def as_json(self) -> Mapping[str, Any]:
        """Each level under the name of its column."""
        slip = {self.slip_name: self.slip, f"{self.slip_name}_source": self.slip_source}
        others = ("source", "flags", "inflation", "outliers", "excess")
        named = {name: getattr(self, name) for name in others}
        return {**self.forces, **(slip if self.slip_name else {}), **named}


@dataclass(frozen=True, kw_only=True)
class Shrinkage:
    """The rms gap beyond the noise and its closure: ``closed`` is 1 - remaining_rms / rms
    with its 90 % interval, None if the gap is not ``resolvable``. Its lower limit is
    :data:`tirefit.diagnosis.summary.closure.WORST`, which includes all worse values."""

    rms: float
    resolvable: bool
    closed: float | None
    closed_ci: tuple[float | None, float | None]
    remaining_rms: float


@dataclass(frozen=True, kw_only=True)
class HeldOut(Shrinkage):
    """The gap on data not used; ``on`` says which."""

    on: str


@dataclass(frozen=True, kw_only=True)
class Gap(Shrinkage):
    """The gap of the first channel on the rows of the file, and of every channel."""

    channels: Mapping[str, Shrinkage]
    holdout: HeldOut | None


class Left(NamedTuple):
    """The remaining gap beyond the noise."""

    rms: float
    share: float  # of the gap's energy
    unlisted: float  # probability that an unlisted effect is present
    looks_like: tuple[Shape, ...] = ()  # shapes it resembles, the most probable first


@dataclass(frozen=True, kw_only=True)
class VerdictSummary(Verdict):
    """The verdict for the report, with a calibrated ``probability``, the share of such verdicts
    that are right; what is ``left``; ``sizes`` of each named effect by groups of each covariate,
    the most unequal first; ``parameters`` are those of a given simulator, empty for a fitted
    form."""

    left: Left
    sizes: Mapping[str, tuple[SizeByGroup, ...]] = field(default_factory=dict)
    parameters: Mapping[str, "Change"] = field(default_factory=dict)

    @property
    def names_an_effect(self) -> bool:
        """Whether effects on the mean force are named, and not only on the noise."""
        return any(effect in self.each for effect in self.effects)

    @property
    def helping(self) -> tuple[str, ...]:
        """The effects of the ladder: named causes, then those that act like one."""
        return (*self.effects, *self.acts_like) if self.names_an_effect else self.acts_like


class Change(NamedTuple):
    """A parameter as simulated and as measured."""

    simulated: float
    measured: float
    std: float  # standard error of ``measured``
    differs: bool  # whether they differ by more than two standard errors


class Part(NamedTuple):
    """A part of the distance from a base to the measurement; shares add to one."""

    part: str  # parameters, the id of an effect, unexplained or noise
    rms: float  # root of its mean square
    share: float  # of the mean square
    closed_ci: tuple[float, float]  # 90 % interval of the share


class Surrogate(NamedTuple):
    """The tire that stands in for a simulator: its rms error [N] in the simulated force
    of the first channel, and that error over the force and over the gap."""

    model: str
    rms: float
    of_force: float
    of_gap: float


class Estimate(NamedTuple):
    """A value with its standard error, and of an effect the probability to be the cause."""

    value: float
    std: float
    unit: str
    probability: float | None = None


class Described(NamedTuple):
    """Forces described by a model with effects.

    ``parameters`` include the slope at zero slip, ``effects`` are those that help,
    ``rms_left_out`` is the error on data left out [N].
    """

    parameters: Mapping[str, Estimate]
    effects: Mapping[str, Estimate]
    rms_left_out: float


class Readings(NamedTuple):
    """Both readings of a simulator.

    Attributes:
        first: "changed" if the simulator, with its parameters and effects changed, predicts
            measured rows left out as well as the ``model`` with effects does, else "described".
        gain: mean square by which the model predicts them better; ``gain_std`` its standard error.
        rms_changed: rms on data left out of the changed simulator.
        model: that describes both.
        measured: description of the measured forces.
        simulator: that of the simulator's; None if it has a structure that the model lacks.
        structure: what the simulator's forces show of it.
    """

    first: str
    gain: float
    gain_std: float
    rms_changed: float
    model: str
    measured: Described
    simulator: Described | None
    structure: tuple[Structure, ...]


class SimulatorSummary(NamedTuple):
    """A simulator that was diagnosed; ``kind`` is columns, model, fit, tir or car."""

    kind: str
    source: str
    sha256: str | None
    surrogate: Surrogate
    readings: Readings | None = None


class Amplitude(NamedTuple):
    """Amplitude of an effect with its standard error, in its own unit."""

    value: float
    std: float
    unit: str
    formula: str = ""  # which of the effect's, in words; "" where there is one


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A set of effects that may explain the gap."""

    effects: tuple[str, ...]
    family: str
    probability: float
    # ``effect: amplitude`` -> size
    parameters: Mapping[str, Amplitude] = field(default_factory=dict)


class NextMeasurement(NamedTuple):
    """A further measurement, the two effects that it distinguishes, and the probabilities
    of distinguishing them without and with it (NaN if there is no forecast)."""

    add: str
    separates: tuple[str, str]
    p_now: float
    p_after: float


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the diagnosis."""

    rig: Rig | None  # None for a car
    effects: tuple[str, ...]  # ids searched
    holdout: tuple[str, ...]  # sha256 of held-out files
    forces: tuple[str, ...] | None = None  # that matter, None for all


UNITS = {"fx": "N", "fy": "N", "mz": "N m", "all": "× noise", "v_y": "m/s", "yaw_rate": "rad/s"}
UNITS |= {"heading": "rad", "x": "m", "y": "m"}
"""Units of the channels of forces and of cars."""

_SEEN = "smallest unlisted remainder that would have been seen"


@dataclass(frozen=True, repr=False, kw_only=True)
class Diagnosis(Record):
    """The diagnosis of a file, or of the logs of a car: the records of the document, in its
    order, then arrays.

    The first channel of a car is all of them over their noise. What only rows of forces have
    is empty or None for a car.
    ``resolution`` is the rms [N] of the smallest unlisted remainder that would have been seen.
    ``budget`` has the parts of the error of the first channel on data left out, by the steps of
    the ladder. ``next_measurement`` has the largest gain first. ``slip_check`` compares the slip
    column with the slip of the wheel speed; None if that is not known. ``runs`` describes the
    differences of the runs, by kind of offset; empty for a single run.
    ``asked`` is a hash of data and settings, by which ``--resume`` recognises the result.

    ``rows`` holds arrays (n,) by channel for all rows of the file, canonical, NaN if
    masked: ``base``, ``extended``, ``gap``, ``gap_std``; for a simulator, ``base`` and
    ``sim`` are its forces as given, ``tuned`` those with adapted parameters.
    ``simulator`` is None if a form was fitted; ``meanings`` are those of its parameters.
    ``table`` is the data; ``comparison`` is the content of a figure; ``library`` holds the
    searched effects, including a user's own.
    """

    text_by: ClassVar[str] = "tirefit.report.diagnosis.report:diagnosis_text"
    html_by: ClassVar[str] = "tirefit.report.diagnosis.report:diagnosis_fragment"
    page_by: ClassVar[str] = "tirefit.report.diagnosis.report:diagnosis_page"
    plot_by: ClassVar[str] = "tirefit.report.diagnosis.figures:plot_diagnosis"

    data: DataSummary
    model: str
    simulator: SimulatorSummary | None
    n: int
    n_effective: float
    noise: NoiseSummary
    gap: Gap
    budget: tuple[Part, ...]
    where: tuple[Region, ...] = ()
    verdict: VerdictSummary
    ladder: Ladder = Ladder()
    candidates: tuple[Candidate, ...]
    untestable: tuple[Untestable, ...]
    resolution: float
    next_measurement: tuple[NextMeasurement, ...]
    slip_check: SlipCheck | None = None
    runs: Mapping[str, RunOffsets] = field(default_factory=dict)
    base_parameters: Mapping[str, float]
    extended_parameters: Mapping[str, float]
    extension: tuple[object, ...]
    settings: Settings
    seed: int
    version: str
    asked: str = ""
    rows: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict, metadata=NOT_WRITTEN)
    table: TireData | None = field(default=None, metadata=NOT_WRITTEN)
    comparison: Comparison | None = field(default=None, metadata=NOT_WRITTEN)
    library: tuple[Effect, ...] = field(metadata=NOT_WRITTEN)
    meanings: Mapping[str, str] = field(metadata=NOT_WRITTEN)

    @property
    def unit(self) -> str:
        """Unit of the first channel: of gap, ladder and remainder."""
        return UNITS[self.data.channels[0]]

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the verdict: empty for none, ``("unknown",)`` for an unlisted effect."""
        return self.verdict.effects

    @property
    def amplitudes(self) -> Mapping[str, Amplitude]:
        """``effect: amplitude`` -> its value in the fit of the effects that help."""
        helping = {*self.verdict.helping}
        fits = (c.parameters for c in self.candidates if {*c.effects} == helping)
        return ByName(next(fits, {}))

    @property
    def readings(self) -> Readings | None:
        """Both readings of a simulator; None without."""
        return self.simulator.readings if self.simulator else None

    def to_frame(self) -> "pandas.DataFrame":
        """The base parameters, the gap and the sizes of the effects that help as a pandas data
        frame: columns kind, name, value, std, unit."""
        return frame(record_of(self.to_dict()).rows).drop(columns=["low", "high", "identified"])

    @property
    def limits(self) -> dict[Outcome, str]:
        """Where the answer of ``verdict`` is open."""
        return self.verdict.status.limits

    def to_dict(self) -> dict[str, Any]:
        """Content of ``NAME.json``."""
        content = {"schema": SCHEMA} | mappings(self)
        on, steps = content["ladder"].values()
        content |= {"ladder": steps, "ladder_on": on, "resolution": {_SEEN: self.resolution}}
        return json_safe(content)

    def files(self, name: str = "") -> dict[str, str]:
        """``NAME.json`` and ``NAME.rows.csv``; of a car ``vehicle_diagnosis.json``."""
        if self.table is None:
            return {"vehicle_diagnosis.json": self.to_json()}
        name = name or self.table.name
        # The document is written last, so that its rows always exist.
        rows = csv_text(rows_in_file_terms(self))
        return {f"{name}.rows.csv": rows, f"{name}.json": self.to_json()}


def mappings(value: Any) -> Any:
    """Records at any depth as mappings: keys are the names of their fields."""
    if hasattr(value, "as_json"):
        return mappings(value.as_json())
    if is_dataclass(value):
        written = (f.name for f in fields(value) if f.metadata.get("written", True))
        return {name: mappings(getattr(value, name)) for name in written}
    if hasattr(value, "_asdict"):
        return mappings(value._asdict())
    if isinstance(value, Mapping):
        return {key: mappings(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [mappings(item) for item in value]
    return value


def rows_in_file_terms(result: Diagnosis) -> dict[str, np.ndarray]:
    """Columns of ``NAME.rows.csv``, in the convention, units and order of the file; none of a
    car."""
    data, out = result.table, dict[str, np.ndarray]()
    if data is None:
        return out
    for channel, parts in result.rows.items():
        header = data.source.columns.get(channel, channel)
        # A difference of forces is converted like a force, as their units have no offset.
        columns = {k: to_convention(data, {channel: x})[header] for k, x in parts.items()}
        # Only a simulator has forces as given and tuned.
        shown = (x for x in ("sim", "tuned", "base", "extended", "gap") if x in columns)
        out |= {f"{name}_{channel}": columns[name] for name in shown}
        out[f"gap_{channel}_std"] = np.abs(columns["gap_std"])
    out["masked"] = (~data.used).astype(int)
    place = data.source.place
    return out if place is None else {name: x[np.argsort(place)] for name, x in out.items()}


def record_of_document(path: Path) -> FileRecord:
    """Row of the table of all results for a diagnosis on disk."""
    return record_of(json.loads(path.read_text(encoding="utf-8")), str(path))


def record_of(content: Mapping[str, Any], path: str = "") -> FileRecord:
    """Row of the table of all results for the document of a diagnosis: base parameters,
    gap, probability of the verdict, and amplitudes of the effects that help."""
    data, gap, verdict = content["data"], content["gap"], content["verdict"]
    unit = UNITS[data["channels"][0]]
    template = MODELS.get(content["model"])
    units = {k: s.unit for k, s in specs(template).items()} if template else {}
    base, helping = content["base_parameters"], {*verdict["effects"], *verdict["acts_like"]}
    rows = [Row("base", k, x, unit=units.get(k, "")) for k, x in base.items()]
    rows += [Row("gap", k, gap[k], unit=unit) for k in ("rms", "remaining_rms")]
    rows += [Row("gap", "closed", gap["closed"])]
    rows += [Row("gap", "probability", verdict["probability"])]
    best = (x for x in content["candidates"] if {*x["effects"]} == helping - {UNKNOWN})
    sizes: Mapping[str, Any] = next(best, {"parameters": {}})["parameters"]
    rows += [Row("effect", k, x["value"], x["std"], unit=x["unit"]) for k, x in sizes.items()]
    status = ": ".join(filter(None, [verdict["status"], ", ".join(verdict["effects"])]))
    return FileRecord(
        data["path"],
        path,
        content["model"],
        status,
        tuple(rows),
        convention=data["convention"],
        seed=content["seed"],
        version=content["version"],
        sha256=data["sha256"],
    )
