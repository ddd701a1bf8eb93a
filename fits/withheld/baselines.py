"""Simple methods without tirefit on the same files, for comparison with the diagnosis.

    python -m fits.withheld.baselines out/withheld --jobs 2

``bic`` fits each listed effect together with c and mu, refits the best five by SciPy
and names the smallest BIC. ``residual`` names the effect whose shape (not projected)
correlates best with the residual of the plain brush. Both use the textbook forms.
``bic_checked`` answers "unknown" if the residual of the best BIC fails a runs test or a
test of local means (``lack_of_fit.py``). ``forest`` (with ``--forest FEATURES.npz``) is a
random forest on features of the residual (``forest.py``).
``ridge`` is a smooth discrepancy over slip, load, speed and time, fitted without the
highest load (or the largest slips); it names no effect. No label is opened.

The answers of each file are written to ``FOLDER/baselines/GROUP`` at once, so that
``--resume`` continues an interrupted run; at the end they are collected in
``FOLDER/baseline_*``, which the scorer reads.
"""

import argparse
import csv
import json
import os
import shutil
import time
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from fits.withheld.effects import EFFECTS
from fits.withheld.forest import Forest, by_forest, trained
from fits.withheld.lack_of_fit import lack_of_fit
from fits.withheld.library import STEP_TIMES, Inputs, base_fit, directions, predict, shapes
from fits.withheld.run import end_with_parent, largest_first

__all__ = [
    "Plain",
    "by_bic",
    "by_residual",
    "checked",
    "from_columns",
    "main",
    "read_trial",
    "ridge",
]

REFITTED = 5
ALARM_OF_FIT = 0.01  # p-value of lack of fit
ALARM = 3.5  # standard errors of a correlation; some twenty are tested
LIMIT = 4.0  # of an amplitude, in typical ones


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of a table; empty cells are NaN."""
    with path.open() as lines:
        rows = list(csv.DictReader(lines))
    return {key: np.array([float(row[key] or "nan") for row in rows]) for key in rows[0]}


def read_trial(path: Path, rig: dict) -> tuple[Inputs, np.ndarray]:
    """Inputs and forces (followed by moments) of a file, all rows."""
    return from_columns(read_columns(path), rig)


def from_columns(columns: dict, rig: dict) -> tuple[Inputs, np.ndarray]:
    """The same from columns."""
    force = "fx" if "sigma_x" in columns else "fy"
    slip = columns["sigma_x"] if force == "fx" else np.tan(columns["alpha"])
    time, fz = columns["time"], columns["fz"]
    gaps = np.diff(time) > 5 * np.median(np.diff(time))
    run = columns.get("run", np.concatenate([[0], np.cumsum(gaps)]))
    noise = rig.get("noise", {})
    slip_std = noise.get("sigma_x", noise.get("alpha", 0.0))
    slip, slip_std = smoothed(slip, run, slip_std)
    moment = "mz" in columns
    x = Inputs(
        time,
        run,
        slip,
        fz,
        columns["v"],
        force,
        (slip_std, noise.get(f"{force}_relative", 0.01) * fz, noise.get("mz_relative", 0.001) * fz),
        cross=np.tan(columns["alpha"]) if {"fx", "alpha"} <= columns.keys() else None,
        gamma=columns.get("gamma"),
        temperature=columns.get("temperature"),
        inflation=columns.get("pressure"),
        across=columns.get("fy" if force == "fx" else "fx"),
        omega="omega" in columns,
        moment=moment,
    )
    observed = [columns[force], *([columns["mz"]] if moment else [])]
    return x, np.concatenate(observed)


def smoothed(slip: np.ndarray, run: np.ndarray, std: float) -> tuple[np.ndarray, float]:
    """Slip and its std; slow sweeps are smoothed over seven points."""
    if std == 0 or np.median(np.abs(np.diff(slip))) > 2 * std:
        return slip, std
    out = slip.copy()
    for one in np.unique(run):
        rows = np.flatnonzero(run == one)
        if len(rows) >= 7:
            out[rows] = savgol_filter(slip[rows], 7, 2)
    return out, 0.58 * std


def bounds_of(effect: str) -> tuple[float, float]:
    """Bounds of an amplitude, in typical ones."""
    sign = EFFECTS[effect].sign
    return (-LIMIT, LIMIT) if sign == 0 else (0.02, LIMIT)


class Plain(NamedTuple):
    """The plain brush on a file, and the change of its forces by each effect (``shapes``)."""

    c: float
    mu: float
    misses: np.ndarray
    std: np.ndarray
    shapes: dict[str, list[np.ndarray]]

    @classmethod
    def of(cls, x: Inputs, observed: np.ndarray) -> "Plain":
        (c, mu), misses, std = base_fit(x, observed)
        return cls(c, mu, misses, std, shapes(x, x.effects, c, mu))


def by_bic(x: Inputs, observed: np.ndarray) -> dict:
    """A diagnosis as a document, by BIC over no effect and every single effect."""
    return _bic(x, observed, Plain.of(x, observed))[0]


def checked(x: Inputs, observed: np.ndarray, plain: Plain | None = None) -> tuple[dict, dict]:
    """The diagnosis by BIC, and the same with a check of the best fit's residual."""
    found, left = _bic(x, observed, plain or Plain.of(x, observed))
    p = lack_of_fit(x, left)
    if p > ALARM_OF_FIT:
        return found, found
    unknown = {"status": "unknown", "effects": ["unknown"], "probability": 1 - p}
    return found, found | {"verdict": found["verdict"] | unknown}


def _bic(x: Inputs, observed: np.ndarray, plain: Plain) -> tuple[dict, np.ndarray]:
    """The diagnosis, and the standardised residual (n,) of the best model."""
    c, mu, misses, std, shaped = plain
    n = len(misses)
    base = directions(x, c, mu) / std[:, None]
    squares, left = {}, {(): misses}
    for effect, several in shaped.items():
        for k, shape in enumerate(several):
            columns = np.column_stack([base, shape / std])
            scale = np.linalg.norm(columns, axis=0) + 1e-12
            best = np.linalg.lstsq(columns / scale, misses, rcond=None)[0] / scale
            rest = misses - columns @ best
            squares[effect, k] = float(rest @ rest), best[2]
            left[effect, k] = rest
    nearest = sorted(squares, key=lambda key: squares[key][0])[:REFITTED]
    for effect, k in nearest:
        low, high = bounds_of(effect)
        start = [0, 0, float(np.clip(squares[effect, k][1], low + 0.01, high - 0.01))]
        share = STEP_TIMES[k] if effect == "friction_step" else 0.5
        size = EFFECTS[effect].typical * (EFFECTS[effect].sign or 1)

        def rest(p, effect=effect, share=share, size=size):
            ratio = np.exp(p[:2])
            force = predict(x, effect, p[2] * size, c * ratio[0], mu * ratio[1], share)
            return np.nan_to_num((observed - force) / std, nan=1e3)

        found = least_squares(
            rest,
            start,
            bounds=([-1, -1, low], [1, 1, high]),
            max_nfev=8,
            loss="linear",
            diff_step=1e-4,
        )
        squares[effect, k] = 2 * found.cost, found.x[2]
        left[effect, k] = found.fun
    criterion, rests = {(): n * np.log(float(misses @ misses) / n)}, {(): misses}
    for (effect, k), (total, _) in squares.items():
        extra = 1 + (effect == "friction_step")
        value = n * np.log(total / n) + extra * np.log(n)
        if value < criterion.get((effect,), np.inf):
            criterion[effect,], rests[effect,] = value, left[effect, k]
    best = min(criterion, key=criterion.get)
    return document(criterion, -0.5), rests[best][: len(x.slip)]


def by_residual(x: Inputs, observed: np.ndarray, plain: Plain | None = None) -> dict:
    """A diagnosis by the largest correlation between the residual and an effect's shape."""
    _, _, misses, std, shaped = plain or Plain.of(x, observed)
    n = len(misses)
    strength = {(): ALARM**2}
    for effect, several in shaped.items():
        for shape in several:
            column = shape / std
            size = np.linalg.norm(column) * np.linalg.norm(misses) + 1e-12
            found = n * float(column @ misses / size) ** 2
            strength[effect,] = max(found, strength.get((effect,), 0.0))
    return document(strength, 0.5)


def document(values: dict, factor: float) -> dict:
    """Verdict and candidates with weights exp(factor * value)."""
    logs = {key: factor * value for key, value in values.items()}
    top = max(logs.values())
    weights = {key: np.exp(value - top) for key, value in logs.items()}
    total = sum(weights.values())
    ranked = sorted(logs, key=logs.get, reverse=True)
    best = ranked[0]
    return {
        "verdict": {
            "status": "named" if best else "none",
            "effects": list(best),
            "probability": float(weights[best] / total),
            "also_possible": [],
        },
        "candidates": [
            {
                "effects": list(key),
                "probability": float(weights[key] / total),
                "family": EFFECTS[key[0]].family,
            }
            for key in ranked
            if key
        ][:10],
    }


def ridge(x: Inputs, observed: np.ndarray) -> dict[str, np.ndarray]:
    """Base and extended force (n,) of a smooth discrepancy, and the rows left out."""
    n = len(x.slip)
    size = np.abs(x.slip)
    highest = x.fz > 0.97 * x.fz.max()
    if np.mean(highest) > 0.5 or "loads" not in x.properties:
        highest = size > np.quantile(size, 2 / 3)
    (c, mu), misses, std = base_fit(x, observed)
    std, y, seen, fold = std[:n], misses[:n], ~highest, np.arange(n) % 5
    base = observed[:n] - y * std
    features = basis(x, c, mu) / (std / std.mean())[:, None]

    def coefficients(rows, strength):
        f = features[rows]
        square = f.T @ f + strength * np.eye(f.shape[1])
        return np.linalg.solve(square, f.T @ y[rows])

    def missed(strength):
        total = 0.0
        for k in range(5):
            test = seen & (fold == k)
            found = coefficients(seen & (fold != k), strength)
            total += np.sum((y[test] - features[test] @ found) ** 2)
        return total

    best = min(np.logspace(-2, 4, 7), key=missed)
    extended = base + std * (features @ coefficients(seen, best))
    return {"base": base, "extended": extended, "held": highest}


def basis(x: Inputs, c: float, mu: float) -> np.ndarray:
    """Gaussian bells over the share of full sliding, times load, speed and time, (n, p)."""
    u = np.clip(c * x.slip / (1.5 * mu * x.fz), -2, 2)
    centres = np.linspace(-2, 2, 13) if u.min() < -0.1 else np.linspace(0, 2, 9)
    bells = np.exp(-(((u[:, None] - centres) / 0.3) ** 2) / 2)
    others = [np.ones(len(u))]
    for column in (x.fz, x.v, x.time):
        spread = np.std(column)
        if spread > 0:
            others.append((column - column.mean()) / spread)
    return np.hstack([bells * other[:, None] for other in others])


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file that replaces ``path`` when it is complete."""
    part = path.with_name(f".{path.name}.part")
    yield part
    part.replace(path)


def answered(
    path: Path, rig: dict, without: Sequence[str], forest: Forest | None
) -> tuple[dict[str, dict], dict[str, np.ndarray]]:
    """The diagnosis of every method for one file, and the forces of the ridge."""
    x, observed = read_trial(path, rig)
    x = x.without(without)
    plain = Plain.of(x, observed)
    found = dict(zip(("bic", "bic_checked"), checked(x, observed, plain), strict=True))
    found["residual"] = by_residual(x, observed, plain)
    if forest:
        found["forest"] = by_forest(forest, x, observed)
    return found, ridge(x, observed)


def kept(path: Path) -> tuple[dict[str, dict], dict[str, np.ndarray]]:
    """The same as written by ``run_group``; empty if there is no such file."""
    if not path.exists():
        return {}, {}
    with np.load(path) as file:
        forces = {name: file[name] for name in file.files}
    return json.loads(str(forces.pop("answers"))), forces


_trained: list[Forest | None] = [None]
"""The forest of a process: too large to be sent with every group."""


def _begin(forest: Forest | None) -> None:
    end_with_parent()
    _trained[0] = forest


def run_group(group: Path, without: Sequence[str], names: set[str], out: Path) -> None:
    """Writes the answers of every file of a group that lacks one of these methods."""
    out.mkdir(parents=True, exist_ok=True)
    begun, files = time.perf_counter(), sorted(group.glob("*.csv"))
    rig = tomllib.loads((group / "rig.toml").read_text())
    for file in files:
        path = out / f"{file.stem}.npz"
        if names <= kept(path)[0].keys():
            continue
        found, forces = answered(file, rig, without, _trained[0])
        with replacing(path) as part, part.open("wb") as opened:
            np.savez(opened, answers=json.dumps(found), **forces)
    spent = time.perf_counter() - begun
    print(f"{group.name}: {len(files)} files, {spent:.0f} s", flush=True)


def gathered(folder: Path, names: Sequence[str]) -> int:
    """Writes the files for the scorer, in the order of the trials; returns their number."""
    answers: dict[str, dict] = {name: {} for name in names}
    closed = {}
    for group in sorted((folder / "trials").iterdir()):
        for file in sorted(group.glob("*.csv")):
            path = folder / "baselines" / group.name / f"{file.stem}.npz"
            found, forces = kept(path)
            for name in names:
                answers[name][file.stem] = found[name]
            closed |= {f"{file.stem}_{key}": value for key, value in forces.items()}
    for name, found in answers.items():
        with replacing(folder / f"baseline_{name}.json") as part:
            part.write_text(json.dumps(found))
    with replacing(folder / "baseline_ridge.npz") as part, part.open("wb") as opened:
        np.savez_compressed(opened, **closed)
    return len(answers["bic"])


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Baselines on a folder of trials")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--forest", type=Path, help="features written by fits.withheld.forest")
    parser.add_argument("--jobs", type=int, default=1, help="groups at a time")
    parser.add_argument("--resume", action="store_true", help="keep existing answers")
    given = parser.parse_args(arguments)
    forest = trained(given.forest)
    left_out = json.loads((given.folder / "leave_out.json").read_text())
    names = ["bic", "bic_checked", "residual", *(["forest"] if forest else [])]
    out = given.folder / "baselines"
    if not given.resume:
        shutil.rmtree(out, ignore_errors=True)
    # Before the processes import NumPy: waiting threads would use other processes' cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    apart = get_context("spawn")
    with ProcessPoolExecutor(given.jobs, apart, _begin, (forest,)) as pool:
        waiting = [
            pool.submit(run_group, group, left_out[group.name], set(names), out / group.name)
            for group in largest_first(given.folder)
        ]
        for one in waiting:
            one.result()
    count = gathered(given.folder, names)
    print(f"{count} files by {', '.join(names)}, ridge")


if __name__ == "__main__":
    main()
