"""A diagnosis on disk: ``NAME.json`` and ``NAME.rows.csv``, whole or not at all."""

import json
from pathlib import Path

import numpy as np

from tirefit.data.records import FileRecord, Row
from tirefit.data.table import TireData
from tirefit.data.write import to_convention, write_csv
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.files import write_text_atomic
from tirefit.models import MODELS
from tirefit.params import specs


def rows_in_file_terms(result: Diagnosis) -> dict[str, np.ndarray]:
    """Columns of ``NAME.rows.csv``, in the file's own convention and units."""
    data: TireData = result.table
    out: dict[str, np.ndarray] = {}
    for channel, parts in result.rows.items():
        header = data.source.columns.get(channel, channel)
        for name in ("sim", "tuned", "base", "extended", "gap"):
            if name not in parts:  # only a simulator is as given, and tuned
                continue
            # A difference of forces converts as a force: units have no offset here.
            column = to_convention(data, {channel: parts[name]})[header]
            out[f"{name}_{channel}"] = column
        spread = to_convention(data, {channel: parts["gap_std"]})[header]
        out[f"gap_{channel}_std"] = np.abs(spread)
    out["masked"] = (~data.used).astype(int)
    return out


def save_diagnosis(result: Diagnosis, directory, name: str) -> list[Path]:
    """Write ``name.json`` and ``name.rows.csv`` into an existing directory."""
    directory = Path(directory)
    rows, document = directory / f"{name}.rows.csv", directory / f"{name}.json"
    write_csv(rows, rows_in_file_terms(result))
    # The document comes last: where it stands, the rows beside it are its own.
    write_text_atomic(document, result.to_json())
    return [document, rows]


def record_of_document(path: Path) -> FileRecord:
    """Row of the table of all results for a diagnosis on disk: base parameters, gap,
    probability of the verdict, and amplitudes of the named effects."""
    content = json.loads(path.read_text(encoding="utf-8"))
    data, gap, verdict = content["data"], content["gap"], content["verdict"]
    unit = "N m" if data["channels"][0] == "mz" else "N"
    template = MODELS.get(content["model"])
    units = {k: s.unit for k, s in specs(template).items()} if template else {}
    rows = [
        Row("base", name, value, unit=units.get(name, ""))
        for name, value in content["base_parameters"].items()
    ]
    rows += [Row("gap", k, gap[k], unit=unit) for k in ("rms", "remaining_rms")]
    rows.append(Row("gap", "closed", gap["closed"]))
    rows.append(Row("gap", "probability", verdict["probability"]))
    named = set(verdict["effects"])
    best = (one for one in content["candidates"] if set(one["effects"]) == named)
    for name, amplitude in next(best, {"parameters": {}})["parameters"].items():
        row = Row("effect", name, amplitude["value"], amplitude["std"])
        rows.append(row._replace(unit=amplitude.get("unit", "")))
    status = ": ".join(filter(None, [verdict["status"], ", ".join(verdict["effects"])]))
    return FileRecord(
        data["path"], str(path), content["model"], status, tuple(rows),
        convention=data["convention"], seed=content["seed"],
        version=content["version"], sha256=data["sha256"],
    )  # fmt: skip
