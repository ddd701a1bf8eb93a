"""Records of diagnoses, as written by :mod:`fits.ablation.collect`."""

import pickle
from pathlib import Path

__all__ = ["loaded"]


def loaded(folder: Path) -> list[dict]:
    """The records of a folder, by name: plain numbers, without tirefit."""
    paths = sorted(folder.glob("*.pickle"))
    if not paths:
        raise SystemExit(f"{folder}: no records; run fits.ablation.collect first")
    return [pickle.loads(path.read_bytes()) for path in paths]
