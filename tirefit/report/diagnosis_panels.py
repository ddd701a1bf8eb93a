"""What the figure of a diagnosis shows, as arrays: nothing is drawn here."""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtr
from scipy.stats import false_discovery_control

from tirefit.data.levels import levels
from tirefit.diagnosis.rates import slip_rate
from tirefit.diagnosis.result import Diagnosis
from tirefit.report.curves import SlipAxis, slip_axis
from tirefit.report.diagnosis_words import names_an_effect
from tirefit.report.numbers import format_number

__all__ = [
    "Bar",
    "ClosureBar",
    "Comparison",
    "LoadCurve",
    "WhereMap",
    "closure_bars",
    "comparison",
    "evidence_bars",
    "mean_load",
    "where_map",
]

_LEVELS = 6
"""Settings with up to so many distinct values are drawn one by one."""
_BANDS = 5
_FEWEST = 4
"""Rows of a cell of the map: fewer say nothing of their own scatter."""
_FARTHEST = 4.0
"""Slip fractions beyond are drawn there: the tire slides in full since one."""
_POINTS, _CURVES, _STEPS = 300, 3, 60
_LABELS = {
    "fz": ("load $F_z$", "N"),
    "v": ("speed $v$", "m/s"),
    "time": ("time", "s"),
    "gamma": (r"camber $\gamma$", "rad"),
    "direction": ("slip in time", ""),
}
_TURNS = {-1.0: "shrinks", 0.0: "steady", 1.0: "grows"}


class WhereMap(NamedTuple):
    """Mean residual of the base fit in cells of slip fraction x another covariate.

    ``edges`` (k+1,) of the signed slip fraction; ``labels`` (m,) of the other one's
    levels; ``mean`` (m, k) in % of F_z, NaN for empty cells; ``beyond`` (m, k): that
    cell's mean is not noise, at 5 % false discoveries (Benjamini-Hochberg);
    ``energy`` (m, k): the share of the located gap's energy that lies there, 0 where
    no gap can be resolved.
    """

    channel: str
    covariate: str
    y_label: str
    labels: tuple[str, ...]
    edges: np.ndarray
    mean: np.ndarray
    beyond: np.ndarray
    energy: np.ndarray


class Bar(NamedTuple):
    """One explanation: ``kind`` is verdict, rival, other, unknown, none or rest."""

    label: str
    probability: float
    kind: str


class LoadCurve(NamedTuple):
    """One level of load: measured points, and both fits as means over bins of slip.

    ``slip``, ``force`` (n,); ``center``, ``base``, ``extended`` (k,); ``low`` and
    ``high`` (k,): where the extended force lies for 80 % of the rows of a bin, as it
    depends on more than slip and load.
    """

    label: str
    slip: np.ndarray
    force: np.ndarray
    center: np.ndarray
    base: np.ndarray
    extended: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Comparison(NamedTuple):
    """Before and after: curves by load; rms residuals [N] in bins of slip fraction.

    The residuals hold the noise, of force and of slip, beside the gap.
    """

    channel: str
    axis: SlipAxis
    after_label: str
    curves: tuple[LoadCurve, ...]
    center: np.ndarray
    before: np.ndarray
    after: np.ndarray


class ClosureBar(NamedTuple):
    """Gap before and after on some rows [N], its 90 % interval, and the shares.

    ``closed`` is 1 - after / before, ``energy`` = 1 - (1 - closed)^2; both are None
    where the gap is too small to say, or nothing was named to close it.
    """

    label: str
    before: float
    after: float
    low: float | None
    high: float | None
    closed: float | None
    energy: float | None


def _levels(values) -> tuple[np.ndarray, tuple[str, ...]]:
    """Codes (n,) of the levels of a covariate, and their names."""
    settings = levels(values)
    if settings.few(_LEVELS):
        return settings.code, tuple(format_number(float(x)) for x in settings.center)
    cuts = np.unique(np.quantile(values, np.linspace(0, 1, _BANDS + 1)))
    codes = np.clip(np.searchsorted(cuts, values, "right") - 1, 0, len(cuts) - 2)
    texts = [format_number(float(x), 3) for x in cuts]
    return codes, tuple(f"{a}-{b}" for a, b in zip(texts, texts[1:], strict=False))


def _covariates(result: Diagnosis) -> dict[str, np.ndarray]:
    """Covariates that vary, (n,) each; loads first, as the usual one."""
    curves = result.curves
    inputs, has = curves["inputs"], curves["has"]
    found = {}
    for need, name in (("loads", "fz"), ("speeds", "v"), ("time", "time")):
        if need in has:
            found[name] = np.asarray(getattr(inputs, name), float)
    if "sweeps" in has:
        time = np.asarray(inputs.time, float)
        turning = slip_rate(curves["slip"], time, curves["run"]).turning
        found["direction"] = np.sign(turning)
    if "gamma" in has:
        found["gamma"] = np.asarray(inputs.gamma, float)
    return found


def _cells(codes, size: int, values):
    """Count, mean and sample standard deviation of each cell, (size,) each."""
    count = np.bincount(codes, minlength=size)
    mean = np.bincount(codes, values, size) / np.maximum(count, 1)
    rest = np.bincount(codes, (values - mean[codes]) ** 2, size)
    return count, mean, np.sqrt(rest / np.maximum(count - 1, 1))


def _energy_seen(codes, size: int, values) -> float:
    """Energy of the cells' means beyond that of their noise."""
    count, mean, std = _cells(codes, size, values)
    there = count >= _FEWEST
    return float(np.sum((count * mean**2 - std**2)[there]))


def _slip_edges(fraction, rows: int) -> np.ndarray:
    # An odd number leaves zero slip, where noise flips the sign, within one cell.
    steps = int(np.clip(len(fraction) // (8 * rows), 4, 14)) | 1
    inside = np.clip(fraction, -_FARTHEST, _FARTHEST)
    edges = np.unique(np.quantile(inside, np.linspace(0, 1, steps + 1)))
    # One value alone would be a map of no width.
    return edges if len(edges) > 1 else edges[0] + np.array([-0.5, 0.5])


def where_map(result: Diagnosis) -> WhereMap:
    """The map over slip fraction and the covariate along which most of the gap shows.

    Loads are preferred where no other covariate shows 5 % more.
    """
    channel = result["data"]["channels"][0]
    curves, parts = result.curves, result.curves["thin"][channel]
    load = np.asarray(curves["inputs"].fz, float)
    residual = 100 * (curves["observed"][channel] - parts["base"]) / load
    options = _covariates(result) or {"fz": load}
    best, chosen = -np.inf, None
    for name, values in options.items():
        codes, labels = _levels(values)
        edges = _slip_edges(curves["slip_fraction"], len(labels))
        inside = np.clip(curves["slip_fraction"], edges[0], edges[-1])
        columns = len(edges) - 1
        column = np.clip(np.searchsorted(edges, inside, "right") - 1, 0, columns - 1)
        cell, size = codes * columns + column, columns * len(labels)
        seen = _energy_seen(cell, size, residual)
        if chosen is None or seen > best + 0.05 * abs(best):
            best, chosen = seen, (name, labels, edges, cell, size)
    name, labels, edges, cell, size = chosen
    count, mean, std = _cells(cell, size, residual)
    there = count >= _FEWEST
    beyond = _beyond(count, mean, std, there, result["noise"]["inflation"])
    energy = np.bincount(cell, parts["gap"] ** 2, size)
    energy = energy * result["gap"]["resolvable"] / max(float(energy.sum()), 1e-300)
    shape = (len(labels), len(edges) - 1)
    text, unit = _LABELS[name]
    if name == "direction":
        labels = tuple(_TURNS[float(label)] for label in labels)
    return WhereMap(
        channel,
        name,
        f"{text} [{unit}]" if unit else text,
        labels,
        edges,
        np.where(there, mean, np.nan).reshape(shape),
        beyond.reshape(shape),
        energy.reshape(shape),
    )


def _beyond(count, mean, std, there, inflation: float) -> np.ndarray:
    """Cells (size,) whose mean is not noise."""
    independent = np.maximum(count / inflation, 1.0)
    t = mean * np.sqrt(independent) / np.maximum(std, 1e-12)
    p = 2 * stdtr(np.maximum(independent - 1, 1.0), -np.abs(t))
    found = np.zeros(len(mean), bool)
    if there.any():
        found[there] = false_discovery_control(p[there]) < 0.05
    return found


def _kind(effects: list[str], verdict) -> str:
    if effects == ["unknown"]:
        return "unknown"
    if effects == list(verdict["effects"]):
        return "verdict"
    rivals = set(verdict["also_possible"])
    return "rival" if rivals & set(effects) else "other"


def evidence_bars(result: Diagnosis, most: int = 7) -> list[Bar]:
    """Probabilities of the explanations, largest first; then unknown, none, the rest.

    The bars add up to one: ``rest`` is what the document does not list.
    """
    verdict, bars = result["verdict"], []
    for candidate in result["candidates"]:
        kind = _kind(candidate["effects"], verdict)
        label = "\n+ ".join(candidate["effects"])
        bars.append(Bar(label, candidate["probability"], kind))
    listed = [bar for bar in bars if bar.kind != "unknown" and bar.label]
    listed = sorted(listed, key=lambda bar: -bar.probability)
    shown = [b for b in listed if b.probability >= 0.005 or b.kind == "verdict"][:most]
    unknown = sum(b.probability for b in bars if b.kind == "unknown")
    unknown_kind = "verdict" if verdict["status"] == "unknown" else "unknown"
    shown.append(Bar("not in the library", unknown, unknown_kind))
    left = max(1 - sum(bar.probability for bar in shown), 0.0)
    none = [c["probability"] for c in result["candidates"] if not c["effects"]]
    if not names_an_effect(verdict) and verdict["status"] != "unknown":
        none = [verdict["probability"]]
    if none:
        kind = "none" if names_an_effect(verdict) else "verdict"
        shown.append(Bar("no gap", none[0], kind))
        return [*shown, Bar("all others", max(left - none[0], 0.0), "rest")]
    return [*shown, Bar("no gap, or another", left, "rest")]


def _binned(x, edges, *columns):
    """Rows of each bin with any: (centers (k,), list of arrays of k means)."""
    codes = np.clip(np.searchsorted(edges, x, "right") - 1, 0, len(edges) - 2)
    count = np.bincount(codes, minlength=len(edges) - 1)
    there = count > 0
    sums = (np.bincount(codes, c, len(edges) - 1)[there] for c in (x, *columns))
    center, *means = (total / count[there] for total in sums)
    return codes, there, center, means


def _load_curve(label, slip, force, base, extended) -> LoadCurve:
    steps = int(np.clip(len(slip) // 8, 8, _STEPS))
    edges = np.unique(np.quantile(slip, np.linspace(0, 1, steps + 1)))
    edges = edges if len(edges) > 1 else edges[0] + np.array([-0.5, 0.5])
    codes, there, center, (before, after) = _binned(slip, edges, base, extended)
    # Within a bin the force rises with slip: only what the extension adds is spread.
    change = extended - base
    low, high = np.array(
        [np.quantile(change[codes == k], [0.1, 0.9]) for k in np.flatnonzero(there)]
    ).T
    points = np.unique(np.linspace(0, len(slip) - 1, _POINTS).astype(int))
    return LoadCurve(
        label, slip[points], force[points], center, before, after,
        before + low, before + high,
    )  # fmt: skip


def comparison(result: Diagnosis) -> Comparison:
    """Both fits over the data at up to three loads, and their residuals over slip.

    Where nothing is named, the located gap stands in for the extension: it says what
    is missing, not why.
    """
    channel = result["data"]["channels"][0]
    curves, parts = result.curves, result.curves["thin"][channel]
    observed = np.asarray(curves["observed"][channel], float)
    after, label = parts["extended"], " + ".join(result.effects)
    if not names_an_effect(result.verdict):
        after, label = parts["base"] + parts["gap"], "base + located gap"
    lateral = curves["mode"] == "y"
    slip = np.arctan(curves["slip"]) if lateral else np.asarray(curves["slip"])
    axis = slip_axis("alpha" if lateral else "sigma_x", slip)
    shown = axis.shown(slip)
    load = np.asarray(curves["inputs"].fz, float)
    codes, names = _levels(load)
    found = np.flatnonzero(np.bincount(codes))
    chosen = np.unique(found[np.linspace(0, len(found) - 1, _CURVES).astype(int)])
    groups = tuple(
        _load_curve(
            f"$F_z$ = {names[k]} N",
            *(x[codes == k] for x in (shown, observed, parts["base"], after)),
        )
        for k in chosen
    )
    fraction = np.clip(curves["slip_fraction"], -_FARTHEST, _FARTHEST)
    edges = _slip_edges(fraction, 1)
    *_, center, (before, rest) = _binned(
        fraction, edges, (observed - parts["base"]) ** 2, (observed - after) ** 2
    )
    return Comparison(
        channel, axis, label, groups, center, np.sqrt(before), np.sqrt(rest)
    )


def _closure_bar(label: str, gap, says: bool) -> ClosureBar:
    closed = gap["closed"] if says else None
    if closed is None:
        return ClosureBar(label, gap["rms"], gap["remaining_rms"], *[None] * 4)
    ends = [gap["rms"] * (1 - share) for share in reversed(gap["closed_ci"])]
    energy = 1 - (1 - closed) ** 2
    return ClosureBar(label, gap["rms"], gap["remaining_rms"], *ends, closed, energy)


def closure_bars(result: Diagnosis) -> list[ClosureBar]:
    """The rows of the file, then the data not used, where there are any."""
    gap, says = result["gap"], names_an_effect(result.verdict)
    bars = [_closure_bar("these rows", gap, says)]
    if gap.get("holdout"):
        held = gap["holdout"]
        bars.append(_closure_bar(f"held out: {held['on']}", held, says))
    return bars


def mean_load(result: Diagnosis) -> float:
    """Mean F_z of the used rows [N]."""
    return float(np.mean(result.table.usable("fz")))
