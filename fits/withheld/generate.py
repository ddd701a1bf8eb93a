"""Writes trials: measurements with a hidden cause, and the labels with that cause.

    python -m fits.withheld.generate --seed 1 --trials 60 --set singles,null,unlisted \\
        --design G,C,B --noise rig,seed --out out/withheld

Writes ``OUT/trials/GROUP/tNNNN.csv`` with its ``rig.toml`` (no label in either), and
``OUT/labels.json``, ``OUT/truth.npz`` and ``OUT/labels.sha256``. ``OUT/leave_out.json``
lists the effects without which each group is diagnosed, and ``OUT/simulators.json`` the
groups that contain the forces of a simulator.
"""

import argparse
import hashlib
import json
import shutil
from pathlib import Path

import numpy as np

from fits.withheld.designs import DESIGNS
from fits.withheld.effects import EFFECTS, family_of
from fits.withheld.measure import NOISE
from fits.withheld.trials import DEVELOPMENT, MIXTURE, SETS, Trial, draw

__all__ = ["main", "write_all"]

FIRST_SEALED_SEED = 1000
RIG = """# What the people at the rig know.
{wheel}run_order = "{order}"

[noise]
{noise}
"""
WHEEL = """rolling_radius = 0.3   # m
wheel_inertia = 1.0    # kg m2
"""


def rig_text(trial: Trial) -> str:
    """rig.toml of a trial: what is stated about the rig, true or not."""
    slip, share, moment = NOISE[trial.label["noise"]]
    design = DESIGNS[trial.label["design"]]
    lateral = design.force == "fy"
    noise = [f"alpha = {slip:.6g}  # rad" if lateral else f"sigma_x = {slip:.6g}"]
    noise.append(f"{design.force}_relative = {share:.6g}  # of the load")
    if design.moment:
        noise.append(f"mz_relative = {moment:.6g}  # m: of the load")
    return RIG.format(
        wheel="" if lateral else WHEEL,
        order="random" if design.shuffled else "sequential",
        noise="\n".join(noise),
    )


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, fmt="%.8g", delimiter=",", header=",".join(columns), comments="")


def write_all(trials: list[Trial], out: Path) -> str:
    """Writes files, labels and truth; returns the SHA-256 of the label file.

    Earlier trials in the folder are removed.

    Raises:
        SystemExit: the folder contains answers to other trials.
    """
    labels, truth, rigs, left_out, simulated = {}, {}, {}, {}, {}
    for number, trial in enumerate(trials):
        name = f"t{number:04d}"
        text = trial.rig or rig_text(trial)
        with_sim = any(column.endswith("_sim") for column in trial.columns)
        key = (text, trial.label["leave_out"], with_sim)
        group = rigs.setdefault(key, f"rig{len(rigs):02d}")
        left_out[group] = [e for e in EFFECTS if family_of(e) == trial.label["leave_out"]]
        simulated[group] = with_sim
        labels[name] = {"file": f"{group}/{name}.csv", **trial.label}
        truth |= {f"{name}_{key}": value for key, value in trial.truth.items()}
    text, kept = json.dumps(labels, indent=1, sort_keys=True), out / "labels.json"
    same = kept.exists() and kept.read_text() == text
    if (out / "answers").exists() and not same:
        raise SystemExit(f"{out} contains answers to other trials: choose another folder")
    shutil.rmtree(out / "trials", ignore_errors=True)
    for (rig, *_), group in rigs.items():
        (out / "trials" / group).mkdir(parents=True)
        (out / "trials" / group / "rig.toml").write_text(rig)
    for label, trial in zip(labels.values(), trials, strict=True):
        write_csv(out / "trials" / label["file"], trial.columns)
    kept.write_text(text)
    (out / "leave_out.json").write_text(json.dumps(left_out, indent=1))
    (out / "simulators.json").write_text(json.dumps(simulated, indent=1))
    np.savez_compressed(out / "truth.npz", **truth)
    digest = hashlib.sha256(text.encode()).hexdigest()
    (out / "labels.sha256").write_text(f"{digest}  labels.json\n")
    return digest


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--trials", type=int, required=True)
    parser.add_argument("--set", default="all", help=f"any of {', '.join(SETS)}, or all")
    parser.add_argument("--design", default="", help=f"any of {', '.join(DESIGNS)}")
    parser.add_argument("--noise", default="rig,seed")
    parser.add_argument("--rows", default="200,900,2000")
    parser.add_argument("--sealed", action="store_true", help="sealed designs and forms")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    if given.sealed != (given.seed >= FIRST_SEALED_SEED):
        parser.error(
            f"--sealed needs a seed of at least {FIRST_SEALED_SEED}; without it, a smaller one"
        )
    if given.seed < 0 or given.trials < 1:
        parser.error("--seed must be at least 0, --trials at least 1")
    sets = list(MIXTURE) if given.set == "all" else given.set.split(",")
    designs = given.design.split(",") if given.design else []
    open_to = DESIGNS if given.sealed else DEVELOPMENT
    for option, asked, known in (
        ("--set", sets, SETS),
        ("--design", designs, open_to),
        ("--noise", given.noise.split(","), NOISE),
    ):
        if unknown := [name for name in asked if name not in known]:
            listed = ", ".join(known)
            parser.error(f"{option}: unknown {', '.join(map(repr, unknown))}; choose from {listed}")
    if not all(n.isdecimal() and int(n) > 0 for n in given.rows.split(",")):
        parser.error("--rows: give numbers of rows, such as 200,900")
    trials = draw(
        given.seed,
        given.trials,
        sets,
        designs,
        given.noise.split(","),
        [int(n) for n in given.rows.split(",")],
        given.sealed,
    )
    digest = write_all(trials, given.out)
    print(f"{len(trials)} trials in {given.out}; labels sealed, SHA-256 {digest}")


if __name__ == "__main__":
    main()
