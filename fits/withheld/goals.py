"""The goals of the extended check, in addition to the thresholds: limit, found, verdict."""

from collections.abc import Iterable

import numpy as np

from fits.withheld.judge import HIDDEN, kind_of
from fits.withheld.thresholds import (
    Check,
    Scored,
    brier,
    check,
    expected_calibration_error,
    share,
    telling,
)

__all__ = ["STRONG", "WEAK", "goals"]

STRONG = (0.8, np.inf)
WEAK = (0.15, 0.5)
"""Range of the rms of the gap after the best plain brush, over the noise (the label's
``gap_over_noise``)."""


def _between(s: Scored, bounds: tuple[float, float], *kinds: str) -> list:
    """Outcomes of these sets whose gap over the noise is within bounds."""
    low, high = bounds
    return s.that(lambda x, o: x["set"] in kinds and low <= x["gap_over_noise"] <= high)


def _reported(outcomes: Iterable) -> tuple:
    return share(o.exact_or_alias for o in outcomes)


def _hidden(s: Scored) -> list[Check]:
    out, unlisted = [], ("unlisted", "procedural")
    for size, bounds, limit in (
        ("gap >= 0.8 of the noise", STRONG, 0.91),
        ("gap 0.15-0.5 of the noise", WEAK, 0.65),
    ):
        of = _between(s, bounds, *unlisted)
        out += [
            check(1, f"unlisted, {size}: flagged", limit, False, share(o.unknown for o in of)),
            check(
                1, f"unlisted, {size}: surely misnamed", 0.03, True, share(o.sure_wrong for o in of)
            ),
        ]
    return out


def _listed(s: Scored) -> list[Check]:
    strong, weak = (_between(s, bounds, "singles") for bounds in (STRONG, WEAK))
    pairs = s.where("pairs")
    return [
        check(2, "listed, strong: exact", 0.95, False, share(o.exact for o in strong)),
        check(2, "listed, weak: exact", 0.88, False, share(o.exact for o in weak)),
        check(3, "exact or reported, strong", 0.98, False, _reported(strong)),
        check(3, "exact or reported, weak", 0.95, False, _reported(weak)),
        check(3, "exact or reported, pairs", 0.85, False, _reported(pairs)),
        check(4, "pairs exact", 0.65, False, share(o.exact for o in pairs)),
    ]


def _others(s: Scored, labels: dict, outcomes: dict) -> list[Check]:
    alarms = s.that(lambda x, o: kind_of(x) == "null")
    # The other effects in the raw measured data are unknown.
    known = s.that(lambda x, o: x["set"] != "raw")
    return [
        check(5, "false alarms", 0.04, True, share(o.flagged for o in alarms)),
        check(6, "family left out: flagged", 0.62, False,
              share(o.unknown for o in s.where("leave_out"))),
        check(6, "foreign tire: flagged", 0.88, False,
              share(o.unknown for o in s.where("foreign"))),
        check(6, "a listed and an unlisted effect: the listed one named", 0.75, False,
              share(o.named for o in s.where("beside"))),
        check(6, "false names with an unlisted effect, per trial", 0.15, True,
              _mean([o.false_names for o in s.where(*HIDDEN)])),
        check(6, "injected into measured data: named", 0.80, False,
              share(o.exact for o in telling(labels, outcomes))),
        check(7, "calibration error", 0.04, True,
              (expected_calibration_error(known), len(known))),
        check(7, "Brier score", 0.14, True, (brier(known), len(known))),
    ]  # fmt: skip


def _mean(values: list[int]) -> tuple[float | None, int]:
    return (float(np.mean(values)) if values else None), len(values)


def _quantile(values: list[float], level: float) -> tuple[float | None, int]:
    return (float(np.quantile(values, level)) if values else None), len(values)


def _simulators(s: Scored) -> list[Check]:
    trials = s.where("simulators")
    held = share(inside for o in trials for inside in o.within)
    off = [part for o in trials for part in o.shares_off]
    return [
        check(8, "simulator: 90 % intervals contain the true parameter", 0.85, False, held),
        check(8, "simulator: the same, no more than", 0.95, True, held),
        check(
            8,
            "simulator: shares of the budget, median error of a part",
            0.05,
            True,
            _quantile(off, 0.5),
        ),
    ]


def _closure(s: Scored) -> list[Check]:
    # An answer without effects claims no closure, and is no evidence.
    claims = s.that(lambda x, o: o.claimed and o.closed is not None)
    off = [abs(o.claimed - o.closed) for o in claims]
    return [
        check(9, "closure, claimed against true, median", 0.02, True, _quantile(off, 0.5)),
        check(9, "closure, claimed against true, 90 %", 0.09, True, _quantile(off, 0.9)),
    ]


def goals(labels: dict, outcomes: dict) -> list[Check]:
    """All goals that the trials can answer, each with its number of trials."""
    s = Scored(labels, outcomes)
    return [*_hidden(s), *_listed(s), *_others(s, labels, outcomes), *_simulators(s), *_closure(s)]
