"""Write a prepared test: a table to fit, a table of segments, and a record."""

import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tirefit import __version__
from tirefit.data.rig.prepare import Prepared
from tirefit.data.rig.segments import Segment
from tirefit.data.rig.set_points import SHOWN
from tirefit.data.table import CANONICAL
from tirefit.data.write import csv_text
from tirefit.door import sealed
from tirefit.files import json_safe, json_text, write_texts

SCHEMA = "tirefit.prepare/1"

_DIGITS = 9  # more than sensors resolve, and the same on every machine


def _number(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def prepared_csv(prepared: Prepared) -> str:
    """The kept rows: run, segment, bin, kind, direction, then the canonical channels.

    ``segment`` is the number of the segment in the file, from 1. ``tirefit.read`` reads
    the constants and the convention from the first line.
    """
    kept, parts, data = prepared.kept, prepared.segments, prepared.data
    number = np.repeat(np.arange(len(parts)), [part.end - part.begin for part in parts])
    rows = number[kept].tolist()
    columns: dict[str, Any] = {
        "run": [data.runs[code] for code in data.run[kept]],
        "segment": [k + 1 for k in rows],
        "bin": [parts[k].bin or "none" for k in rows],
        "kind": [parts[k].kind for k in rows],
        "direction": [parts[k].direction for k in rows],
    }
    columns["time"] = [_number(t) for t in prepared.series.time[kept]]
    for name in CANONICAL:
        if name in prepared.columns:
            columns[name] = [_number(v) for v in prepared.columns[name][kept]]
    stated = [f"{key}={value:.6g}" for key, value in data.source.constants.items()]
    constants = f", constants {' '.join(stated)}" if stated else ""
    first = f"# tirefit {__version__}: prepared from {data.file}".replace("\n", " ")
    return f"{first}, SI units{constants}, convention braking\n{csv_text(columns)}"


def _segment(prepared: Prepared, k: int, part: Segment) -> dict[str, Any]:
    time, line = prepared.series.time, prepared.data.source.line
    row = {
        "segment": k + 1,
        "kind": part.kind,
        "channel": part.channel,
        "direction": part.direction,
        "run": prepared.data.runs[prepared.data.run[part.begin]],
        "begin": _number(time[part.begin]),
        "end": _number(time[part.end - 1]),
        "first_line": int(line[part.begin]) if line is not None else part.begin,
        "last_line": int(line[part.end - 1]) if line is not None else part.end - 1,
        "rows": part.end - part.begin,
        "kept": int(prepared.kept[part.begin : part.end].sum()),
        "bin": part.bin,
    }
    for name in prepared.settings:
        level = part.level.get(name, -1) if part.is_held else -1
        held = prepared.settings[name].center
        row[name] = _number(held[level]) if level >= 0 else float("nan")
    return row


def save_prepared(prepared: Prepared, folder: Path, name: str = "") -> list[Path]:
    """Write ``NAME.csv``, ``NAME.segments.tsv`` and ``NAME.prepare.json``.

    Only the table to fit ends in ``.csv``, so that ``*.csv`` matches no other table.
    """
    name = name or prepared.data.name
    rows = [_segment(prepared, k, part) for k, part in enumerate(prepared.segments)]
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    texts = {f"{name}.csv": prepared_csv(prepared), f"{name}.segments.tsv": csv_text(columns, "\t")}
    digests = {key: hashlib.sha256(text.encode()).hexdigest() for key, text in texts.items()}
    texts[f"{name}.prepare.json"] = json_text(record_of(prepared, digests))
    write_texts({folder / key: text for key, text in texts.items()})
    return [folder / key for key in texts]


def record_of(prepared: Prepared, files: Mapping[str, str]) -> dict[str, Any]:
    """The record of all settings and steps, with a checksum.

    Args:
        files: name -> sha256 of each file written.
    """
    source, config = prepared.data.source, prepared.config
    chosen = prepared.filter
    content = {
        "schema": SCHEMA,
        "version": __version__,
        "input": {"path": source.path, "sha256": source.sha256},
        "read": dict(prepared.read),
        "config": config.model_dump(),
        "convention": {
            "input": source.convention,
            "output": "braking",
            "units": {c: CANONICAL[c][0] for c in prepared.columns},
        },
        "sampling_rate": prepared.series.rate,
        "filter": None
        if chosen is None
        else {
            "kind": "zero-phase Butterworth, two passes of order 2",
            "bandwidth": chosen.bandwidth,
            "corner_of_one_pass": chosen.corner,
            "reach": chosen.reach,
            "channels": list(prepared.columns),
        },
        "settings": {
            name: [
                {"name": label, "center": center, "usual_stray": width}
                for label, center, width in zip(
                    prepared.names[name], s.center, s.width, strict=True
                )
            ]
            for name, s in prepared.settings.items()
            if s.is_held
        },
        "rows": {
            "file": len(prepared.data),
            "kept": int(prepared.kept.sum()),
            "by_kind": prepared.rows_by_kind(),
        },
        "segments": [_segment(prepared, k, part) for k, part in enumerate(prepared.segments)],
        "notes": list(prepared.notes),
        "assumptions": list(source.assumptions),
        "warnings": list(source.warnings),
        "masked": [str(problem) for problem in source.masked],
        "files": dict(files),
    }
    return sealed(json_safe(content))


def summary(prepared: Prepared) -> str:
    """A summary of the segments, in a few lines."""
    rows, used = prepared.rows_by_kind(), prepared.rows_by_kind(kept=True)
    total, kept = len(prepared.data), int(prepared.kept.sum())
    count = Counter(part.kind for part in prepared.segments)
    lines = [
        f"{prepared.data.name}: {kept} of {total} rows kept"
        f" ({', '.join(prepared.config.keep)}), convention braking, SI units"
    ]
    for kind, number in count.items():
        lines.append(f"  {number:>4} {kind:<12} {used[kind]:>8} of {rows[kind]} rows kept")
    for name, settings in prepared.settings.items():
        if settings.is_held:
            held = prepared.names[name]
            unit = SHOWN[name][1]
            listed = ", ".join(text.removesuffix(f" {unit}") for text in held)
            lines.append(f"  {name} set to {listed} {unit}")
    lines += [f"  {note}" for note in prepared.notes]
    return "\n".join(lines)
