"""A diagnosis on disk: ``NAME.json`` and ``NAME.rows.csv``, whole or not at all."""

from pathlib import Path

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.write import to_convention, write_csv
from tirefit.diagnosis.result import Diagnosis
from tirefit.files import write_text_atomic

__all__ = ["rows_in_file_terms", "save_diagnosis"]


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
