"""A random forest on features of the residual, trained on development trials.

    python -m fits.withheld.forest --trials 1500 --out out/forest.npz   # the features
    python -m fits.withheld.baselines out/withheld --forest out/forest.npz --jobs 2

This is the approach with many labelled examples and no physics beyond the plain brush.
The features describe the residual of the brush, in standard deviations: its mean
over the slip fraction, load, speed and time, by the sign of the slip and its direction,
its autocorrelation in time and over the slip, spread and tails, its correlation with
every column times smooth functions of the slip fraction. The classes are no effect, every
listed effect, and an unlisted effect. It needs scikit-learn (dependency group "check").
"""

import argparse
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fits.withheld.effects import EFFECTS
from fits.withheld.library import Inputs, base_fit

__all__ = ["Forest", "by_forest", "class_of", "features", "main", "trained"]

TREES = 400
SEED = 701  # of the training trials: a development seed
LAGS = (1, 2, 5, 10, 20)
SETS = ("singles", "singles", "null", "unlisted", "singles", "procedural", "foreign",
        "singles", "null", "singles")  # fmt: skip


class Forest(NamedTuple):
    model: object
    classes: tuple[str, ...]


def _means(values, place, parts) -> list[float]:
    """Mean times the square root of the count for each part, in standard errors."""
    out = []
    for k in range(parts):
        inside = values[place == k]
        out.append(float(inside.sum() / np.sqrt(max(len(inside), 1))))
    return out


def _parts(values, parts) -> np.ndarray:
    """(n,) index of equal parts of the range; 0 for constant values."""
    width = np.ptp(values)
    if width < 1e-9:
        return np.zeros(len(values), int)
    return np.minimum(((values - values.min()) / width * parts).astype(int), parts - 1)


def _correlation(a, b) -> float:
    size = np.linalg.norm(a - a.mean()) * np.linalg.norm(b - b.mean())
    return float((a - a.mean()) @ (b - b.mean()) / size) if size > 1e-12 else 0.0


def features(x: Inputs, observed: np.ndarray) -> np.ndarray:
    """Features of the main channel's residual: finite values, fixed length."""
    n = len(x.slip)
    (c, mu), misses, _ = base_fit(x, observed)
    e, sign = misses[:n], np.where(x.slip < 0, -1.0, 1.0)
    u = np.clip(c * x.slip / (1.5 * mu * x.fz), -2, 2)
    along = e * sign  # towards more force
    growing = np.gradient(np.abs(x.slip)) > 0
    out = _means(e, np.minimum((5 * (u + 2)).astype(int), 19), 20)
    for chosen in (along, e):
        for values, parts in ((x.fz, 4), (x.v, 4), (x.time, 10)):
            out += _means(chosen, _parts(values, parts), parts)
    out += _means(along, (x.slip < 0).astype(int), 2)
    out += _means(along, growing.astype(int), 2)
    by_slip = e[np.argsort(x.slip)]
    for values in (e, by_slip):
        out += [_correlation(values[lag:], values[:-lag]) for lag in LAGS]
    out += [float(np.std(e)), float(np.mean(e**4) / np.mean(e**2) ** 2)]
    size = _parts(np.abs(u), 3)
    out += [float(np.std(e[size == k])) if np.sum(size == k) > 2 else 1.0 for k in range(3)]
    rate = np.gradient(x.slip)
    columns = [x.fz, x.v, x.time, x.temperature, x.gamma, x.inflation, x.across,
               x.cross, rate, x.slip]  # fmt: skip
    shapes = (sign, u, np.clip(u, -1, 1) ** 2 * sign, np.ones(n))
    for column in columns:
        for shape in shapes:
            there = column is not None
            q = (column - column.mean()) * shape if there else np.zeros(n)
            out.append(np.sqrt(n) * _correlation(e, q))
    have = x.properties
    wanted = sorted({need for effect in EFFECTS.values() for need in effect.needs})
    out += [float(name in have) for name in wanted] + [float(np.log(n))]
    if x.moment:
        late = misses[n:]
        out += [float(np.std(late)), *_means(late, _parts(u, 6), 6)]
    else:
        out += [0.0] * 7
    return np.nan_to_num(np.array(out))


def class_of(label: dict) -> str:
    """ "none", an effect, or "unknown"."""
    if label["set"] in ("unlisted", "procedural", "foreign"):
        return "unknown"
    return label["effects"][0] if label["effects"] else "none"


def fitted(table: np.ndarray, classes: Sequence[str]) -> Forest | None:
    """The trained forest; without scikit-learn None, and a printed line."""
    try:
        from sklearn.ensemble import RandomForestClassifier
    except ImportError:
        print('forest: skipped, no scikit-learn (dependency group "check")')
        return None
    model = RandomForestClassifier(TREES, min_samples_leaf=2, random_state=0, n_jobs=1)
    model.fit(table, list(classes))
    return Forest(model, tuple(model.classes_))


def trained(path: Path | None) -> Forest | None:
    """The forest trained on a file of features; without it None, and a printed line."""
    if path is None or not path.exists():
        print("forest: skipped, no features of development trials (--forest)")
        return None
    with np.load(path) as kept:
        return fitted(kept["features"], kept["classes"].tolist())


def by_forest(forest: Forest, x: Inputs, observed: np.ndarray) -> dict:
    """A diagnosis as a document; effects that are left out are not named."""
    share = forest.model.predict_proba(features(x, observed)[None])[0]
    found = {
        name: float(p)
        for name, p in zip(forest.classes, share, strict=True)
        if name not in x.left_out
    }
    total = sum(found.values()) or 1.0
    ranked = sorted(found, key=found.get, reverse=True)
    best = ranked[0]
    status = {"none": "none", "unknown": "unknown"}.get(best, "named")
    return {
        "verdict": {
            "status": status,
            "effects": [] if best == "none" else [best],
            "probability": found[best] / total,
            "also_possible": [],
        },
        "candidates": [
            {"effects": [name], "probability": found[name] / total, "family": EFFECTS[name].family}
            for name in ranked
            if name in EFFECTS
        ][:10],
    }


def main(arguments: list[str] | None = None) -> None:
    from fits.withheld.baselines import from_columns
    from fits.withheld.generate import rig_text
    from fits.withheld.trials import draw

    parser = argparse.ArgumentParser(description="Write the features that train a random forest")
    parser.add_argument("--trials", type=int, default=1500)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    table, classes = [], []
    for trial in draw(SEED, given.trials, SETS, [], ("rig", "seed"), (200, 900, 2000), False):
        x, observed = from_columns(trial.columns, tomllib.loads(rig_text(trial)))
        table.append(features(x, observed))
        classes.append(class_of(trial.label))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(given.out, features=np.array(table), classes=np.array(classes))
    print(f"{len(classes)} development trials of seed {SEED} in {given.out}")


if __name__ == "__main__":
    main()
