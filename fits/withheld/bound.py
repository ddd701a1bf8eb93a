"""What was possible: the exact evidence with the generator's own forms.

An observer who knows the plain brush, every form that the generator has of every
effect, the prior of the amplitudes and the law of the noise names the effect of the
largest evidence. Amplitude, stiffness and friction are profiled (Laplace). On the
average over such trials hardly any method that sees the file alone is right more often.
"""

import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from fits.withheld.baselines import read_trial
from fits.withheld.effects import EFFECTS
from fits.withheld.library import Inputs, base_fit, directions, predict
from fits.withheld.thresholds import share

__all__ = ["bound_rows", "evidence", "named_by_evidence"]

REFITTED = 10
SHARES = tuple(np.linspace(0.05, 0.95, 10))  # of the range of a form's random draws
LOW, HIGH = 0.5, 2.0  # amplitudes, in typical ones: log-uniform
SPREAD = np.array([0.09, 0.06])  # of log c and log mu, as they are drawn
VISIBLE = 5  # sqrt(lambda)


def _hypotheses(x: Inputs) -> Iterator[tuple]:
    """(effect, form, share, sign) of all that one amplitude makes."""
    for effect in x.effects:
        about = EFFECTS[effect]
        for form in about.forms:
            for part in SHARES if form.startswith("road_") else (0.5,):
                for sign in (about.sign,) if about.sign else (-1, 1):
                    yield effect, form, part, sign


def _force(x: Inputs, key: tuple, strength, c, mu) -> np.ndarray:
    effect, form, part, sign = key
    size = EFFECTS[effect].typical * sign * strength
    return predict(x, effect, size, c, mu, part, form)


def _refitted(x, observed, std, key, c, mu) -> float:
    """Log evidence of one form, up to a constant that all hypotheses share."""

    def rest(p):
        ratio = np.exp(p[:2] * SPREAD)
        force = _force(x, key, np.exp(p[2]), c * ratio[0], mu * ratio[1])
        return np.nan_to_num((observed - force) / std, nan=1e3)

    limits = np.log(LOW), np.log(HIGH)
    fit = least_squares(
        rest, [0, 0, 0], bounds=([-9, -9, limits[0]], [9, 9, limits[1]]), max_nfev=8,
        diff_step=1e-3, x_scale=[0.1, 0.1, 0.3],
    )  # fmt: skip
    return -fit.cost + _laplace(fit.jac[:, 2], fit.jac[:, :2])


def _laplace(along: np.ndarray, base: np.ndarray) -> float:
    """Log of the share of the prior's range that the data leave to the amplitude."""
    left = along - base @ np.linalg.lstsq(base, along, rcond=None)[0]
    width = np.sqrt(2 * np.pi) / max(float(np.linalg.norm(left)), 1e-9)
    return float(np.log(min(width / np.log(HIGH / LOW), 1.0)))


def evidence(
    x: Inputs, observed: np.ndarray, more: tuple = (), refitted: int = REFITTED
) -> dict[tuple[str, ...], float]:
    """Log evidence of nothing, () and of every single effect, over its forms.

    Args:
        more: an effect whose forms are refitted, however far they look.
    """
    (c, mu), misses, std = base_fit(x, observed)
    plain = observed - misses * std
    base = directions(x, c, mu) / std[:, None]
    first = {}
    for key in _hypotheses(x):
        shape = (_force(x, key, 1.0, c, mu) - plain) / std
        columns = np.nan_to_num(np.column_stack([base, shape]))
        scale = np.linalg.norm(columns, axis=0) + 1e-12
        best = np.linalg.lstsq(columns / scale, misses, rcond=None)[0] / scale
        best[2] = np.clip(best[2], LOW, HIGH)
        again = np.linalg.lstsq(base, misses - best[2] * columns[:, 2], rcond=None)[0]
        left = misses - best[2] * columns[:, 2] - base @ again
        first[key] = -0.5 * float(left @ left) + _laplace(columns[:, 2], base)
    nearest = sorted(first, key=first.get, reverse=True)[:refitted]
    told = [key for key in first if key[0] in more]
    nearest += sorted(told, key=first.get, reverse=True)[: refitted // 2]
    refits = {k: _refitted(x, observed, std, k, c, mu) for k in dict.fromkeys(nearest)}
    parts: dict = {}
    for key in first:
        about = EFFECTS[key[0]]
        draws = (len(SHARES) if key[1].startswith("road_") else 1) * (
            2 - abs(about.sign)
        )
        value = refits.get(key, -np.inf) - np.log(len(about.forms) * draws)
        parts.setdefault((key[0],), []).append(value)
    out = {
        effect: float(np.logaddexp.reduce(values)) for effect, values in parts.items()
    }
    return out | {(): -0.5 * float(misses @ misses)}


def named_by_evidence(x: Inputs, observed: np.ndarray, effect: str) -> str:
    """The effect of the largest evidence, "" for none; the true one is tried well."""
    found = evidence(x, observed, (effect,))
    return "".join(max(found, key=found.get))


def bound_rows(folder: Path, labels: dict, outcomes: dict, count: int) -> list:
    """[of what, n, possible, answered; both where sqrt(lambda) >= 5] for a table.

    The first ``count`` trials with one effect that have an answer, by name.
    """
    names = [k for k in sorted(outcomes) if labels[k]["set"] == "singles"][:count]
    right = {}
    for name in names:
        path = folder / "trials" / labels[name]["file"]
        rig = tomllib.loads((path.parent / "rig.toml").read_text())
        x, observed = read_trial(path, rig)
        effect = labels[name]["effects"][0]
        right[name] = named_by_evidence(x, observed, effect) == effect
    if not names:
        return []
    seen = [name for name in names if labels[name]["root_lambda"] >= VISIBLE]
    numbers = [
        share(right[k] for k in of) if which else share(outcomes[k].exact for k in of)
        for of in (names, seen) for which in (True, False)
    ]  # fmt: skip
    cells = ["-" if value is None else f"{value:.3f} ({n})" for value, n in numbers]
    return [["one effect, exact", str(len(names)), *cells]]
