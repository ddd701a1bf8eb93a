"""What a diagnosis found: :class:`Diagnosis`, as JSON, as rows, as text."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, ClassVar

import numpy as np

from tirefit.data.table import TireData
from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.evidence.forms import RunOffsets
from tirefit.diagnosis.left_out.ladder import Ladder
from tirefit.diagnosis.rows.rig import SlipCheck
from tirefit.diagnosis.summary.records import (
    Candidate,
    Cell,
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
    Spot,
    Untestable,
    VerdictSummary,
)
from tirefit.diagnosis.summary.views import Comparison, LookCurve, ResidualMap
from tirefit.display import Displayed
from tirefit.files import json_text

SCHEMA = "tirefit.diagnosis/3"

_NOT_WRITTEN = {"written": False}


@dataclass(frozen=True, repr=False, kw_only=True)
class Diagnosis(Displayed):
    """One file diagnosed: the records of the document, in its order, then arrays.

    ``budget`` is that of the first channel, ``budgets`` those of all.
    ``next_measurement`` is ranked, the largest gain first; where it is empty,
    ``next_measurement_reason`` says why. ``slip_check`` is the slip column against the
    slip of the wheel speed, None where that is not known. ``runs`` says how far the
    runs differ, by kind of offset; empty for a single run. ``spots`` are short
    stretches within the regions of ``where``.

    ``rows`` holds (n,) arrays by channel of all rows of the file, canonical, NaN where
    masked: ``base``, ``extended``, ``gap``, ``gap_std``; for a simulator ``base`` is it
    as given, also under ``sim``, and ``tuned`` its parameters adapted. ``simulator`` is
    None where a form was fitted; ``meanings`` of its parameters. ``table`` is the data,
    ``mean_load`` [N] that of its used rows; ``residual_map``, ``comparison`` and
    ``look`` are what the figures show, the last None where nothing unlisted shows a
    shape; ``library`` holds the effects that were looked for, a user's own among them.
    """

    text_by: ClassVar[str] = "tirefit.report.diagnosis_text:diagnosis_text"
    html_by: ClassVar[str] = "tirefit.report.diagnosis_html:diagnosis_fragment"

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
    spots: tuple[Spot, ...] = ()
    map: tuple[Cell, ...]
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
    settings: Settings
    seed: int
    version: str
    rows: Mapping[str, Mapping[str, np.ndarray]] = field(metadata=_NOT_WRITTEN)
    table: TireData = field(metadata=_NOT_WRITTEN)
    mean_load: float = field(metadata=_NOT_WRITTEN)
    residual_map: ResidualMap = field(metadata=_NOT_WRITTEN)
    comparison: Comparison = field(metadata=_NOT_WRITTEN)
    look: LookCurve | None = field(metadata=_NOT_WRITTEN)
    library: tuple[Effect, ...] = field(metadata=_NOT_WRITTEN)
    meanings: Mapping[str, str] = field(metadata=_NOT_WRITTEN)

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the verdict: empty for none, ``("unknown",)`` for not listed."""
        return self.verdict.effects

    def to_json(self) -> str:
        """The document; not-a-number and infinite become null."""
        content = {"schema": SCHEMA} | _mappings(self)
        on, steps = content["ladder"].values()
        return json_text(content | {"ladder": steps, "ladder_on": on})


def _mappings(value: Any) -> Any:
    """Records at any depth as mappings: keys are the names of their fields."""
    if hasattr(value, "as_json"):
        return _mappings(value.as_json())
    if is_dataclass(value):
        written = (f.name for f in fields(value) if f.metadata.get("written", True))
        return {name: _mappings(getattr(value, name)) for name in written}
    if hasattr(value, "_asdict"):
        return _mappings(value._asdict())
    if isinstance(value, Mapping):
        return {key: _mappings(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_mappings(item) for item in value]
    return value
