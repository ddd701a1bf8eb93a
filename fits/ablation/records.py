"""Records of diagnoses, as :mod:`fits.ablation.collect` keeps them."""

import pickle
from pathlib import Path

__all__ = ["loaded"]


def loaded(folder: Path) -> list[dict]:
    """The records of a folder, by name: plain numbers, without tirefit."""
    paths = sorted(folder.glob("*.pickle"))
    if not paths:
        raise SystemExit(f"{folder}: no records, see fits.ablation.collect")
    return [pickle.loads(path.read_bytes()) for path in paths]
