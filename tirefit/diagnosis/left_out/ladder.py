"""How the gap shrinks on data left out, effect by effect."""

from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.evidence.posterior import Key
from tirefit.diagnosis.left_out.predicted import Predicted
from tirefit.diagnosis.negligible import NONZERO

SMOOTH: Key = ("anything smooth",)
NOISE: Key = ("noise",)
"""``Step.effects`` of the last two steps of a ladder: what the discrepancy closes, and
the noise floor."""


class Gain(NamedTuple):
    """What a set of effects gains over another on data left out.

    Attributes:
        gain: difference of the sums of squares over the noise, all channels.
        std: its standard error over the parts left out.
        closed: share of the gap beyond the noise that it closes, first channel.
        closed_std: its standard error.
        parts: how many parts were left out.
    """

    gain: float
    std: float
    closed: float
    closed_std: float
    parts: int


class Step(NamedTuple):
    """One step of the ladder.

    Attributes:
        effects: ids of the set; ("anything smooth",) and ("noise",) at the end.
        rms_left_out: of observed minus predicted on the rows left out [N].
        closed: share of what no effect leaves beyond the noise that is closed there.
        closed_std: its standard error over the parts left out.
        gain: what the step takes from the mean square [N^2]; the two last steps are
            compared with the last set of effects.
        gain_std: its standard error.
    """

    effects: tuple[str, ...]
    rms_left_out: float
    closed: float
    closed_std: float
    gain: float
    gain_std: float


class Ladder(NamedTuple):
    """The steps, and ``on``: what was left out; no steps where nothing could be."""

    on: str = ""
    steps: tuple[Step, ...] = ()


_UNRESOLVED = 0.01
"""Gap over the noise, in energy, below which none is resolved."""


def _error(parts) -> float:
    """Standard error of a sum of independent parts (F,)."""
    return float(np.sqrt(len(parts)) * np.std(parts, ddof=1))


def gained(out: Predicted, new: int, old: int, floor: float) -> Gain:
    """What set ``new`` gains over set ``old``.

    Args:
        floor: mean square of the noise of the first channel [N^2].
    """
    parts = out.whitened[:, old] - out.whitened[:, new]
    closed, error = _closed(out, out.loss[:, new], out.loss[:, old], floor)
    return Gain(float(parts.sum()), _error(parts), closed, error, len(parts))


def _closed(out: Predicted, after, before, floor: float) -> tuple[float, float]:
    """1 - rms(after) / rms(before) beyond the noise, and its error by the jackknife
    over the parts left out."""
    share = out.rows / out.rows.sum()

    def closed(share):
        gap = max(float(share @ before) - floor, _UNRESOLVED * floor, NONZERO)
        left = max(float(share @ after) - floor, 0.0)
        return float(np.clip(1 - np.sqrt(left / gap), -1.0, 1.0))

    count = len(share)
    each = []
    for fold in range(count):
        others = np.where(np.arange(count) == fold, 0.0, share)
        each.append(closed(others / others.sum()))
    spread = np.sum((each - np.mean(each)) ** 2) * (count - 1) / count
    return float(closed(share)), float(np.sqrt(spread))


def ladder_of(out: Predicted, key: Key, floor: float) -> Ladder:
    """The steps from no effect to a set of effects, then what anybody could close.

    Each step adds the effect that predicts the rows left out best.

    Args:
        key: the named effects; the step to a set that was not refitted is left out.
        floor: mean square of the noise of the first channel [N^2].
    """
    share = out.rows / out.rows.sum()
    at = {one: k for k, one in enumerate(out.effects)}
    now: Key = ()
    order: tuple[str, ...] = ()
    steps = [_step((), out, at[()], at[()], at[()], floor)]
    for size in range(1, len(key) + 1):
        larger = [k for k in at if len(k) == size and {*now} < {*k} <= {*key}]
        if not larger:
            continue
        best = min(larger, key=lambda k: out.whitened[:, at[k]].sum())
        order += tuple(e for e in best if e not in order)
        steps.append(_step(order, out, at[best], at[now], at[()], floor))
        now = best
    last = out.loss[:, at[now]]
    for name, losses in ((SMOOTH, out.smooth), (NOISE, np.full(len(share), floor))):
        none = out.loss[:, at[()]]
        closed = (1.0, 0.0) if name == NOISE else _closed(out, losses, none, floor)
        parts = share * (last - losses)
        rms = float(np.sqrt(share @ losses))
        steps.append(Step(name, rms, *closed, float(parts.sum()), _error(parts)))
    return Ladder(out.on, tuple(steps))


def _step(effects, out: Predicted, new: int, old: int, none: int, floor) -> Step:
    share = out.rows / out.rows.sum()
    parts = share * (out.loss[:, old] - out.loss[:, new])
    closed = _closed(out, out.loss[:, new], out.loss[:, none], floor)
    rms = float(np.sqrt(share @ out.loss[:, new]))
    return Step(effects, rms, *closed, float(parts.sum()), _error(parts))
