"""The result of a diagnosis (:class:`Diagnosis`): ``NAME.json`` and ``NAME.rows.csv``."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tirefit.data.records import FileRecord, Row
from tirefit.data.table import TireData
from tirefit.data.write import csv_text, to_convention
from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.engine.left_out import Ladder
from tirefit.diagnosis.extended import SCHEMA, Extension
from tirefit.diagnosis.rows.rig import SlipCheck
from tirefit.diagnosis.rows.runs import RunOffsets
from tirefit.diagnosis.summary.records import (
    Candidate,
    DataSummary,
    Forecast,
    Gap,
    NextMeasurement,
    NoiseSummary,
    Part,
    Region,
    Resolution,
    Settings,
    SimulatorSummary,
    Untestable,
    VerdictSummary,
)
from tirefit.diagnosis.summary.views import Comparison, LookCurve, ResidualMap
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.models import MODELS
from tirefit.params import specs
from tirefit.results import Outcome

NOT_WRITTEN = {"written": False}


@dataclass(frozen=True, repr=False, kw_only=True)
class Diagnosis(Record):
    """The diagnosis of a file: the records of the document, in its order, then arrays.

    ``budget`` is that of the first channel, ``budgets`` those of all. ``next_measurement`` has the
    largest gain first; if it is empty, ``next_measurement_reason`` is the reason. ``slip_check``
    compares the slip column with the slip of the wheel speed; None if that is not known. ``runs``
    describes the differences of the runs, by kind of offset; empty for a single run.

    ``rows`` holds arrays (n,) by channel for all rows of the file, canonical, NaN if
    masked: ``base``, ``extended``, ``gap``, ``gap_std``; for a simulator, ``base`` and
    ``sim`` are its forces as given, ``tuned`` those with adapted parameters.
    ``simulator`` is None if a form was fitted; ``meanings`` are those of its parameters.
    ``table`` is the data, ``mean_load`` [N] that of its used rows; ``residual_map``,
    ``comparison`` and ``look`` are the contents of figures, the last None if no unlisted
    effect has a shape; ``library`` holds the searched effects, including a user's own.
    """

    text_by: ClassVar[str] = "tirefit.report.diagnosis_text:diagnosis_text"
    html_by: ClassVar[str] = "tirefit.report.diagnosis_html:diagnosis_fragment"
    page_by: ClassVar[str] = "tirefit.report.diagnosis_html:diagnosis_page"
    plot_by: ClassVar[str] = "tirefit.report.diagnosis_draw:plot_diagnosis"

    data: DataSummary
    model: str
    simulator: SimulatorSummary | None
    n: int
    n_effective: float
    noise: NoiseSummary
    gap: Gap
    budget: tuple[Part, ...]
    budgets: Mapping[str, tuple[Part, ...]]
    where: tuple[Region, ...]
    verdict: VerdictSummary
    ladder: Ladder = Ladder()
    candidates: tuple[Candidate, ...]
    untestable: tuple[Untestable, ...]
    resolution: Resolution
    forecast: tuple[Forecast, ...]
    next_measurement: tuple[NextMeasurement, ...]
    next_measurement_reason: str | None
    slip_check: SlipCheck | None
    runs: Mapping[str, RunOffsets] = field(default_factory=dict)
    base_parameters: Mapping[str, float]
    extended_parameters: Mapping[str, float]
    extension: Extension
    settings: Settings
    seed: int
    version: str
    rows: Mapping[str, Mapping[str, np.ndarray]] = field(metadata=NOT_WRITTEN)
    table: TireData = field(metadata=NOT_WRITTEN)
    mean_load: float = field(metadata=NOT_WRITTEN)
    residual_map: ResidualMap = field(metadata=NOT_WRITTEN)
    comparison: Comparison = field(metadata=NOT_WRITTEN)
    look: LookCurve | None = field(metadata=NOT_WRITTEN)
    library: tuple[Effect, ...] = field(metadata=NOT_WRITTEN)
    meanings: Mapping[str, str] = field(metadata=NOT_WRITTEN)

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the verdict: empty for none, ``("unknown",)`` for an unlisted effect."""
        return self.verdict.effects

    @property
    def limits(self) -> dict[Outcome, str]:
        """Where the answer of ``verdict`` is open."""
        return self.verdict.status.limits

    def to_dict(self) -> dict[str, Any]:
        """Content of ``NAME.json``."""
        content = {"schema": SCHEMA} | mappings(self)
        on, steps = content["ladder"].values()
        return json_safe(content | {"ladder": steps, "ladder_on": on})

    def files(self, name: str = "") -> dict[str, str]:
        """``NAME.json`` and ``NAME.rows.csv``."""
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
    """Columns of ``NAME.rows.csv``, in the convention and units of the file."""
    data, out = result.table, {}
    for channel, parts in result.rows.items():
        header = data.source.columns.get(channel, channel)
        # A difference of forces is converted like a force, as their units have no offset.
        own = {k: to_convention(data, {channel: x})[header] for k, x in parts.items()}
        for name in ("sim", "tuned", "base", "extended", "gap"):
            if name in own:  # only a simulator has forces as given and tuned
                out[f"{name}_{channel}"] = own[name]
        out[f"gap_{channel}_std"] = np.abs(own["gap_std"])
    return out | {"masked": (~data.used).astype(int)}


def record_of_document(path: Path) -> FileRecord:
    """Row of the table of all results for a diagnosis on disk: base parameters, gap,
    probability of the verdict, and amplitudes of the named effects."""
    content = json.loads(path.read_text(encoding="utf-8"))
    data, gap, verdict = content["data"], content["gap"], content["verdict"]
    unit = "N m" if data["channels"][0] == "mz" else "N"
    template = MODELS.get(content["model"])
    units = {k: s.unit for k, s in specs(template).items()} if template else {}
    base, helping = content["base_parameters"], {*verdict["effects"], *verdict["acts_like"]}
    rows = [Row("base", k, x, unit=units.get(k, "")) for k, x in base.items()]
    rows += [Row("gap", k, gap[k], unit=unit) for k in ("rms", "remaining_rms")]
    rows += [Row("gap", "closed", gap["closed"])]
    rows += [Row("gap", "probability", verdict["probability"])]
    best = (one for one in content["candidates"] if set(one["effects"]) == helping - {"unknown"})
    for name, amplitude in next(best, {"parameters": {}})["parameters"].items():
        value, std, unit = (amplitude[k] for k in ("value", "std", "unit"))
        rows.append(Row("effect", name, value, std, unit=unit))
    status = ": ".join(filter(None, [verdict["status"], ", ".join(verdict["effects"])]))
    return FileRecord(
        data["path"],
        str(path),
        content["model"],
        status,
        tuple(rows),
        convention=data["convention"],
        seed=content["seed"],
        version=content["version"],
        sha256=data["sha256"],
    )
