"""The clues of trials, one JSON line each.

python -m fits.calibration.collect OUT 0/2      # every second trial, from the first
"""

import json
import sys
from pathlib import Path

import jax
import numpy as np

from tirefit.data.read import read
from tirefit.diagnosis.decide.conclusion import Judge
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.engine import studied
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import load_rig
from tirefit.fitting.problem import find_model
from tirefit.models import modelled

__all__ = ["clues_of", "main"]


def clues_of(path: Path, without: list[str], seed: int = 0) -> dict:
    """Clues of one file, as far as it has a gap.

    ``best``: the most probable set, ``share`` its probability among the listed.
    """
    generator = np.random.default_rng(seed)
    rig, model = load_rig(path.parent / "rig.toml"), find_model("brush")
    prepared = prepare(read(str(path), convention="braking"), rig, modelled(model))
    case = studied(prepared, "brush", rig, EFFECTS, without, generator)
    key = case.weighed.best
    if case.verdict.status == "none" or not key:
        return {"best": [], "share": None, "more": None, "beside": {}}
    judge = Judge(case.search, case.weighed, generator)
    return {
        "best": key, "share": case.weighed.among_listed(key),
        "more": judge.clues(key), "beside": judge.clues_by_effect(key),
    }  # fmt: skip


def main(out: Path, shard: str) -> None:
    """The trials that nobody has kept yet."""
    number, of = (int(part) for part in shard.split("/"))
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(out.absolute() / "compiled"))
    kept = out / f"clues-{number}-of-{of}.jsonl"
    done = {
        json.loads(line)["trial"]
        for path in out.glob("clues-*.jsonl")
        for line in path.read_text().splitlines()
    }
    for folder in sorted(out.iterdir()):
        if not (folder / "labels.json").exists():
            continue
        labels = json.loads((folder / "labels.json").read_text())
        told = json.loads((folder / "leave_out.json").read_text())
        # Row counts and channels one after the other: one program serves them.
        for name in sorted(labels, key=lambda n: (labels[n]["force"], labels[n]["n"]))[
            number::of
        ]:
            trial, label = f"{folder.name}/{name}", labels[name]
            if trial in done:
                continue
            path = folder / "trials" / label["file"]
            record = {
                "trial": trial, "set": label["set"], "kind": label["kind"],
                "effects": label["effects"], "families": label["families"],
                **clues_of(path, told[path.parent.name]),
            }  # fmt: skip
            with kept.open("a") as file:
                file.write(json.dumps(record) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
