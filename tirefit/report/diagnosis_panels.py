"""What the figure of a diagnosis shows beside its arrays: bars and labels."""

from typing import NamedTuple

from tirefit.diagnosis.summary.records import Shrinkage, VerdictSummary
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.diagnosis.summary.views import LoadCurve, ResidualMap
from tirefit.report.diagnosis_words import (
    UNLISTED,
    listed_candidates,
    nothing,
    said_effects,
)
from tirefit.report.numbers import format_number

_LABELS = {
    "fz": "load $F_z$ [N]",
    "v": "speed $v$ [m/s]",
    "time": "time [s]",
    "gamma": r"camber $\gamma$ [rad]",
    "direction": "slip in time",
}
_TURNS = {-1.0: "shrinks", 0.0: "steady", 1.0: "grows"}


class Bar(NamedTuple):
    """One explanation: ``kind`` is verdict, rival, other, unknown, none or rest."""

    label: str
    probability: float
    kind: str


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


def covariate_label(panel: ResidualMap) -> str:
    """Axis label of what the map is drawn over beside the slip."""
    return _LABELS[panel.covariate]


def level_labels(panel: ResidualMap) -> tuple[str, ...]:
    """Names of the levels of the map: one value, or from - to."""
    if panel.covariate == "direction":
        return tuple(_TURNS[float(low)] for low in panel.levels[:, 0])
    return tuple(_range(low, high) for low, high in panel.levels)


def _range(low: float, high: float) -> str:
    if low == high:
        return format_number(float(low))
    return f"{format_number(float(low), 3)}-{format_number(float(high), 3)}"


def load_label(curve: LoadCurve) -> str:
    """Name of the load of a curve."""
    return f"$F_z$ = {_range(*curve.load)} N"


def after_label(result: Diagnosis) -> str:
    """What the curves after stand for."""
    if not result.comparison.named:
        return "base + located gap"
    named = result.effects if result.verdict.names_an_effect else ()
    return " + ".join((*(["parameters"] if result.simulator else []), *named))


def _kind(effects: tuple[str, ...], verdict: VerdictSummary) -> str:
    if effects == verdict.effects:
        return "verdict"
    return "rival" if set(verdict.also_possible) & set(effects) else "other"


def evidence_bars(result: Diagnosis, most: int = 7) -> list[Bar]:
    """Probabilities of the explanations, largest first; then of something unlisted,
    none, the rest.

    The bars add up to one: ``rest`` is what the document does not list. Only the bar of
    an incomplete verdict is a part of another, that of something unlisted.
    """
    verdict = result.verdict
    bars = [
        Bar(
            "\n+ ".join(said_effects(c, verdict)), c.probability,
            _kind(c.effects, verdict),
        )
        for c in listed_candidates(result.candidates)
    ]  # fmt: skip
    bars = sorted(bars, key=lambda bar: -bar.probability)
    shown = [b for b in bars if b.probability >= 0.005 or b.kind == "verdict"][:most]
    parts = [b for b in shown if b.kind != "verdict" or verdict.status != "incomplete"]
    left = max(1 - verdict.unlisted - sum(bar.probability for bar in parts), 0.0)
    kind = "verdict" if verdict.status == "unknown" else "unknown"
    label = UNLISTED.replace(", ", ",\n")
    shown.append(Bar(label, verdict.unlisted, kind))
    if (none := nothing(result)) is not None:
        label, probability = none
        kind = "none" if verdict.names_an_effect else "verdict"
        shown.append(Bar(label.replace(" its", "\nits"), probability, kind))
        return [*shown, Bar("all others", max(left - probability, 0.0), "rest")]
    # Beside a gap that is said to be there, nothing is left for none.
    surely = verdict.status in ("unknown", "incomplete")
    rest = "all others" if surely else "no gap, or another"
    return [*shown, Bar(rest, left, "rest")]


def _closure_bar(label: str, gap: Shrinkage, says: bool) -> ClosureBar:
    low, high = gap.closed_ci
    if gap.closed is None or low is None or high is None or not says:
        return ClosureBar(label, gap.rms, gap.remaining_rms, None, None, None, None)
    return ClosureBar(
        label, gap.rms, gap.remaining_rms, gap.rms * (1 - high), gap.rms * (1 - low),
        gap.net_closed, gap.energy_closed,
    )  # fmt: skip


def closure_bars(result: Diagnosis) -> list[ClosureBar]:
    """The rows of the file, then the data not used, where there are any."""
    gap = result.gap
    says = result.verdict.names_an_effect or result.simulator is not None
    bars = [_closure_bar("these rows", gap, says)]
    if gap.holdout is not None:
        bars.append(_closure_bar(f"held out: {gap.holdout.on}", gap.holdout, says))
    return bars
