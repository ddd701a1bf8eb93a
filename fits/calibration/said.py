"""How often verdicts are right, by status and by how sure they were."""

import json
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from fits.withheld.effects import NOISE_EFFECTS
from fits.withheld.judge import judge

__all__ = ["lines_of", "verdicts_of"]

FARTHEST = 0.005  # of a probability from zero or one
RIDGE = 2.0  # 1 / variance of offset and slope about 0 and 1


def verdicts_of(folder: Path) -> list[tuple[str, float, bool]]:
    """(status, probability, right) of each answered trial; "noise" is the status of a
    verdict that names effects on the noise alone."""
    found = []
    for name, label in json.loads((folder / "labels.json").read_text()).items():
        path = folder / "answers" / Path(label["file"]).with_suffix(".json")
        if label["set"] == "raw" or not path.exists():
            continue
        answer = json.loads(path.read_text())
        verdict, outcome = answer["verdict"], judge(name, label, answer)
        on_noise = verdict["effects"] and set(verdict["effects"]) <= set(NOISE_EFFECTS)
        status = "noise" if on_noise else verdict["status"]
        found.append((status, verdict["probability"], outcome.right))
    return found


def lines_of(verdicts) -> dict[str, list[float]]:
    """Offset and slope, by status, of the log odds of being right over the log odds
    that were said, by logistic regression, drawn towards 0 and 1."""
    each = defaultdict(list)
    for status, said, right in verdicts:
        each[status].append((said, right))
    lines = {}
    for status, cases in sorted(each.items()):
        said, right = np.array(cases, float).T
        p = np.clip(said, FARTHEST, 1 - FARTHEST)
        odds = np.log(p / (1 - p))

        def loss(line, odds=odds, right=right):
            t = line[0] + line[1] * odds
            drawn = line[0] ** 2 + (line[1] - 1) ** 2
            return np.sum(np.logaddexp(0, t) - right * t) + RIDGE / 2 * drawn

        lines[status] = [round(float(v), 4) for v in minimize(loss, [0.0, 1.0]).x]
    return lines
