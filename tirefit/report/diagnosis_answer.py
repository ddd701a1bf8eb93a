"""The answer of a diagnosis: the largest part of the error first, with its size and remedy."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.summary.closure import PARAMETERS
from tirefit.diagnosis.summary.result import Change, Diagnosis
from tirefit.report.diagnosis_readings import (
    FRICTION,
    ratio_text,
    readings_text,
    set_text,
    used_friction,
)
from tirefit.report.diagnosis_words import amount_text, listing, name_of, share_text, words_on
from tirefit.report.numbers import format_estimate, format_number

_SHORT = {"mu": "friction", "cpa2": "stiffness", "mu_peak": "peak friction"}
"""Short names of parameters for sentences."""


def answer(result: Diagnosis) -> str:
    """The answer: the largest part of the error first, what to do about it, what else there
    is, and what is left."""
    changes, verdict = change_texts(result), result.verdict
    shares = {part.part: part.share for part in result.budget}
    beyond = "its parameters and " if changes else ""
    sentences = [_on_effects(result, shares, beyond)]
    if changes:
        own = shares.get(PARAMETERS, 0.0)
        of_error = f", {share_text(own)} of its error" * (PARAMETERS in shares)
        largest = max((shares.get(effect, 0.0) for effect in verdict.effects), default=0.0)
        first = not verdict.names_an_effect or own >= largest
        sentences.insert(0 if first else 1, f"The simulator has {listing(changes)}{of_error}.")
    changed = " ".join([*sentences, *_how_much(result), *_no_help(result)])
    return readings_text(result, changed)


def _how_much(result: Diagnosis) -> Iterator[str]:
    """The rms of the gap without and with the effects that help, or that it is small."""
    gap, unit = result.gap, result.unit
    if not result.verdict.helping:
        return
    before, after = (format_number(x, 2) for x in (gap.rms, gap.remaining_rms))
    if gap.resolvable:
        takes = "This takes" if len(result.verdict.helping) == 1 else "These take"
        yield f"{takes} the gap from {before} to {after} {unit} (rms)."
    else:
        noise = result.noise.forces.get(result.data.channels[0])
        beside = f" beside {format_number(noise, 2)} {unit} of noise" if noise else ""
        yield f"The gap is small: {before} {unit} (rms){beside}."


def _no_help(result: Diagnosis) -> Iterator[str]:
    """A sentence if the named effects predict the held-out files worse."""
    steps = [s for s in result.ladder.steps if s.rms_held_out is not None]
    plain = next((s for s in steps if not s.effects), None)
    if plain is None or not result.verdict.helping:
        return
    before, after = plain.rms_held_out, steps[-1].rms_held_out
    if before is not None and after is not None and after > before:
        unit = result.unit
        old, new = (format_number(x, 3) for x in (before, after))
        yield (
            f"On the files held out it does not help ({old} to {new} {unit} rms): the"
            " answer is of the diagnosed files alone."
        )


def _on_effects(result: Diagnosis, shares: Mapping[str, float], beyond: str) -> str:
    verdict = result.verdict
    like = _acting(result, shares, "the error" if verdict.names_an_effect else "it")
    if verdict.status == Status.UNKNOWN:
        return (
            f"There is a gap beyond {beyond}the noise, and no listed effect is its likely"
            f" cause. Probability {verdict.left.unlisted:.2f} of an unlisted effect.{like}"
        )
    if not verdict.names_an_effect:
        of_noise = [name_of(e) for e in verdict.effects if e != "unknown"]
        tail = f" The noise shows {listing(of_noise)}." if of_noise else ""
        return (
            f"There is no gap beyond {beyond}the noise. Probability"
            f" {verdict.probability:.2f} of no effect, listed or unlisted.{tail}"
        )
    causes = carried(result, verdict.effects, shares)
    parts = [_cause_text(result, effect, shares) for effect in causes]
    beside = (
        f"; an unlisted effect is likely as well ({verdict.left.unlisted:.2f})"
        if verdict.status == Status.INCOMPLETE
        else ""
    )
    part = " in part" if beside or like else ""
    return f"The gap comes{part} from {'; then from '.join(parts)}{beside}.{like}"


def _cause_text(result: Diagnosis, effect: str, shares: Mapping[str, float]) -> str:
    """A cause with its size, its probability, its share of the error, and its remedy."""
    each = result.verdict.each[effect]
    text = f"{name_of(effect)}{of_size(result, effect)}"
    if each.twins:
        names = listing([name_of(twin) for twin in each.twins], "or")
        text += f" or {names}, which this data cannot tell apart"
    text += f" ({each.probability:.2f})"
    if effect in shares:
        text += f", {share_text(shares[effect])} of the error's mean square"
    # The first remedy; all are under the effects.
    remedy = words_on(effect, result.library, bool(result.data.motion))[1].partition(";")[0]
    return f"{text}: {remedy}" if remedy and not each.twins else text


def of_size(result: Diagnosis, effect: str) -> str:
    """``of 0.27 ± 0.03 m``: the sizes of an effect that helps; empty if it has none."""
    sizes = [
        amount_text(amplitude.value, amplitude.std, amplitude.unit)
        for name, amplitude in result.amplitudes.items()
        if name.startswith(f"{effect}: ")
    ]
    return f" of {listing(sizes)}" if sizes else ""


def carried(result: Diagnosis, effects: Sequence[str], shares: Mapping[str, float]) -> list[str]:
    """The effects, the largest share of the error first, without those that predict held-out
    files worse, unless all of them do."""
    steps = result.ladder.steps
    added = [{*steps[k].effects} - {*steps[k - 1].effects} for k in worse_steps(result)]
    worse = set().union(*added)
    kept = [effect for effect in effects if effect not in worse] or effects
    return sorted(kept, key=lambda effect: -shares.get(effect, 0.0))


def worse_steps(result: Diagnosis) -> Iterator[int]:
    """Numbers of the steps that predict the held-out files worse than the previous step."""
    for k, (before, after) in enumerate(pairwise(result.ladder.steps), 1):
        old, new = before.rms_held_out, after.rms_held_out
        if old is not None and new is not None and new > old:
            yield k


def _acting(result: Diagnosis, shares: Mapping[str, float], what: str) -> str:
    """A sentence on effects that help without being the likely cause; empty for none."""
    parts = []
    for effect in carried(result, result.verdict.acts_like, shares):
        each = result.verdict.each[effect]
        text = f"{name_of(effect)}{of_size(result, effect)}"
        text += f" ({each.probability:.2f} that this is the cause"
        if each.closed_left_out is not None:
            text += f"; it removes {share_text(each.closed_left_out)} on data left out"
        parts.append(f"{text})")
    return f" In the model, {what} acts like {listing(parts)}." if parts else ""


def change_texts(result: Diagnosis) -> list[str]:
    """Errors of the simulator's parameters, such as ``friction 9 ± 1 % too high``, most
    significant first; only those that differ from the measurement."""
    wrong = [(k, c) for k, c in result.verdict.parameters.items() if c.differs]
    wrong.sort(key=lambda kc: kc[1].std / abs(kc[1].simulated - kc[1].measured))
    words = {**result.meanings, **_SHORT}
    both = result.simulator.readings if result.simulator else None
    lacks = {one.id for one in both.structure} if both else set()
    if "no_saturation" in lacks:
        wrong = [(name, change) for name, change in wrong if name not in FRICTION]
    used = used_friction(result) if wrong else 0.0
    return [_change_text(name, words.get(name, name), change, used) for name, change in wrong]


def _change_text(name: str, meaning: str, change: Change, used: float) -> str:
    off = change.simulated - change.measured
    if min(change.simulated, change.measured) > 0:
        ratio = change.simulated / change.measured
        error = ratio * change.std / change.measured
        return ratio_text(name, meaning, ratio, error, change.measured, used)
    side = f"{'high' if off > 0 else 'low'} ({set_text(name, change.measured)})"
    return f"{meaning} {format_estimate(abs(off), change.std)} too {side}"
