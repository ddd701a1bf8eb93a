"""One file diagnosed: noise first, then where, which, how far, and what to measure."""

import importlib.metadata
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from tirefit.data.table import TireData
from tirefit.diagnosis.base import Base, fit_base, with_noise_judged
from tirefit.diagnosis.basis import located
from tirefit.diagnosis.closure import Closure, closure_of
from tirefit.diagnosis.effects import EFFECTS, Effect, atoms_of
from tirefit.diagnosis.forecast import next_measurements
from tirefit.diagnosis.forms import PLACE, shape_of_change
from tirefit.diagnosis.holdout import held_out
from tirefit.diagnosis.noise import correlation
from tirefit.diagnosis.result import SCHEMA, Diagnosis
from tirefit.diagnosis.rig import Rig
from tirefit.diagnosis.rows import Prepared, prepare
from tirefit.diagnosis.search import Hypothesis, Search, search
from tirefit.diagnosis.shares import closed_by_each
from tirefit.diagnosis.verdict import (
    Verdict,
    Weighed,
    fitted_form,
    gap_p_value,
    judge,
    linear_at,
    weigh,
)
from tirefit.diagnosis.where import regions
from tirefit.fitting.problem import find_model
from tirefit.models import modelled

__all__ = ["diagnose"]

_CHANGED = 0.1
"""A change of the noise level, as a logarithm, after which the search starts anew."""

_MOST_ROWS = 6000
"""The search looks at so many rows, evenly spread; the last word is on all of them."""


@dataclass(frozen=True)
class _Case:
    """Everything known of one file when its verdict stands."""

    base: Base
    search: Search
    weighed: Weighed
    verdict: Verdict
    untestable: list[dict]


def diagnose(
    data: TireData,
    model: str = "brush",
    *,
    rig: Rig | None = None,
    effects: Sequence[Effect] = EFFECTS,
    holdout: Sequence[TireData] = (),
    seed: int = 0,
) -> Diagnosis:
    """Where a model misses the data, which unmodelled effect causes it, how far the
    gap shrinks once it is added.

    Args:
        data: measured rows; see ``tirefit.read``.
        model: name of the base model.
        rig: what is known of the rig (noise, rolling radius, wheel inertia).
        effects: the library to search; add your own to :data:`EFFECTS`.
        holdout: data not used for the search, to check the closure on.
        seed: of the simulated null distributions and bootstraps.

    Raises:
        UsageError: no such model.
        DataError: no force with a slip that varies, no load, or too few rows.
    """
    rig = rig or Rig()
    base_model = find_model(model)
    generator = np.random.default_rng(seed)
    thin = _thinned(data)
    prepared = prepare(thin, rig, modelled(base_model))
    case = _studied(prepared, model, rig, tuple(effects), generator)
    return _document(case, data, rig, holdout, generator, model, seed)


def _thinned(data: TireData) -> TireData:
    """The same data with at most :data:`_MOST_ROWS` rows used."""
    if data.n <= _MOST_ROWS:
        return data
    rows = np.flatnonzero(data.used)
    chosen = np.zeros(len(data), bool)
    chosen[rows[np.linspace(0, len(rows) - 1, _MOST_ROWS).astype(int)]] = True
    return data.where(chosen)


def _testable(prepared: Prepared, atoms) -> tuple[list[int], list[dict]]:
    possible, missing = [], {}
    for k, atom in enumerate(atoms):
        effect = atom.effect
        lacks = [need for need in effect.needs if need not in prepared.has]
        if effect.channels and not set(effect.channels) & set(prepared.channels):
            lacks += list(effect.channels)
        if lacks:
            missing[effect.id] = {"effect": effect.id, "needs": lacks}
        else:
            possible.append(k)
    return possible, list(missing.values())


def amplitudes_of(base: Base, hypothesis: Hypothesis) -> np.ndarray:
    """Amplitudes of all atoms (K,) in their own units."""
    full = np.zeros(len(base.atoms))
    scale = np.asarray(base.design.prior_scale)
    for k, a in zip(hypothesis.atoms, hypothesis.amplitude, strict=True):
        full[k] += a * scale[k]
    return full


def _level(base: Base) -> np.ndarray:
    return np.array(
        [
            np.log(np.median(noise.std)) + 0.5 * np.log(noise.inflation)
            for noise in base.noise.values()
        ]
    )


def _studied(prepared: Prepared, model, rig, effects, generator) -> _Case:
    atoms = atoms_of(effects)
    base = fit_base(prepared, model, atoms, rig)
    testable, untestable = _testable(prepared, atoms)
    found = search(base, testable)
    # What the best explanation leaves shows the noise better than the base fit does.
    best = found.best
    judged = with_noise_judged(base, rig, best.z, amplitudes_of(base, best))
    again = np.any(np.abs(_level(judged) - _level(base)) > _CHANGED)
    again |= any(
        np.any(judged.noise[c].outlier != noise.outlier)
        for c, noise in base.noise.items()
    )
    shaped = _with_change(judged if again else base, found)
    if again or shaped is not None:
        base = shaped or judged
        found = search(base, testable)

    def amplitudes(hypothesis):
        return amplitudes_of(base, hypothesis)

    weighed = weigh(found, amplitudes)
    verdict = judge(found, weighed, gap_p_value(found, generator), amplitudes)
    return _Case(base, found, weighed, verdict, untestable)


def _with_change(base: Base, found: Search) -> Base | None:
    """The base with the shape of a sudden change, where one is among the best."""
    fitted = [h for h in found.hypotheses if h.refitted]
    ranked = sorted(fitted, key=lambda h: -h.log_weight)[:4]
    likely = [h for h in ranked if "friction_step" in h.effects]
    if not likely or not any(a.effect.id == "friction_step" for a in base.atoms):
        return None
    steps = [k for k, a in enumerate(base.atoms) if a.effect.id == "friction_step"]
    amplitudes = amplitudes_of(base, likely[0])
    rest = [k for k in likely[0].atoms if k not in steps]
    residual, jacobian, columns, fields = base.linearised(likely[0].z, amplitudes)
    # The residual without the step, to first order.
    own = [k for k in likely[0].atoms if k in steps]
    size = amplitudes[own] / np.asarray(base.design.prior_scale)[own]
    residual = residual + columns[:, own] @ size
    used_up = np.concatenate([jacobian, columns[:, rest]], axis=1)
    rows = base.design.rows
    shape = shape_of_change(
        base.prepared.covariates.time, fields[:, PLACE["friction"]], used_up, residual
    )
    padded = np.zeros(len(base.design.keep))
    padded[: len(shape)] = shape
    return replace(base, design=base.design._replace(rows=rows._replace(change=padded)))


def _document(case: _Case, data, rig, holdout, generator, model, seed) -> Diagnosis:
    base, verdict = case.base, case.verdict
    prepared = base.prepared
    rows = _rows(case)
    closures = _closures(case, rows, generator)
    main = prepared.channels[0]
    chosen = closures[main]
    content = {
        "schema": SCHEMA,
        "data": {
            "name": data.name, "path": data.source.path, "sha256": data.source.sha256,
            "convention": data.source.convention, "channels": list(prepared.channels),
            "assumptions": [*data.source.notes, *rig.notes],
        },
        "model": model,
        "n": data.n,
        "n_effective": prepared.n / max(n.inflation for n in base.noise.values()),
        "noise": _noise_record(case),
        "gap": _gap_record(chosen, verdict)
        | {"p_value": verdict.p_value, "channels": {
            c: _gap_record(v, verdict) for c, v in closures.items()
        }},
        "where": _where(case, rows),
        "verdict": _verdict_record(case),
        "candidates": _candidates(case, generator),
        "untestable": case.untestable,
        "resolution": _resolution(case),
        "next_measurement": next_measurements(base, case.search, case.weighed, verdict),
        "base_parameters": _base_parameters(base, base.z),
        "extended_parameters": _base_parameters(base, verdict.chosen.z),
        "settings": {"rig": asdict(rig), "effects": list(dict.fromkeys(
            atom.effect.id for atom in base.atoms
        )), "holdout": [other.source.sha256 for other in holdout]},
        "seed": seed,
        "version": importlib.metadata.version("tirefit"),
    }  # fmt: skip
    content["gap"]["holdout"] = held_out(case, holdout, rig, generator)
    named = verdict.status not in ("none", "unknown")
    content["gap"]["shares"] = closed_by_each(base, verdict.chosen) if named else {}
    curves = {
        "slip": prepared.slip, "slip_fraction": base.slip_fraction,
        "mode": prepared.mode, "run": prepared.run, "scores": case.search.score,
        "observed": dict(prepared.observed), "has": sorted(prepared.has),
        "inputs": prepared.inputs, "thin": rows,
    }  # fmt: skip
    return Diagnosis(content, _all_rows(case, data, rig, rows), data, curves)


def _rows(case: _Case) -> dict[str, dict[str, np.ndarray]]:
    """Base, extended, located gap and its deviation, canonical, used rows."""
    base, verdict = case.base, case.verdict
    null = case.weighed.best_of[()]
    before = base.forces(null.z, np.zeros(len(base.atoms)))
    after = base.forces(verdict.chosen.z, amplitudes_of(base, verdict.chosen))
    smooth, deviation = _smoothed_remainder(case)
    form = _form_part(case)
    found, n = {}, base.prepared.n
    for k, channel in enumerate(base.prepared.channels):
        scale = np.asarray(base.design.scale[channel])[:n]
        part = slice(k * n, (k + 1) * n)
        found[channel] = {
            "base": before[channel],
            "extended": after[channel] + form[part] * scale,
            "gap": after[channel] - before[channel] + (form + smooth)[part] * scale,
            "gap_std": deviation[part] * scale,
        }
    return found


def _form_part(case: _Case) -> np.ndarray:
    """What another form of the named effects adds to their formulas, whitened (m,)."""
    base, chosen = case.base, case.verdict.chosen
    key = tuple(sorted(chosen.effects))
    if key not in case.weighed.other_form:
        return np.zeros(len(base.prepared.channels) * base.prepared.n)
    return fitted_form(linear_at(base, chosen, amplitudes_of(base, chosen)))


def _smoothed_remainder(case: _Case):
    """Whitened generic remainder of the chosen fit and the deviation of the located
    gap, (m,) each; no remainder where a verdict explains all."""
    base, chosen = case.base, case.verdict.chosen
    residual, jacobian, tangent, _ = base.linearised(
        chosen.z, amplitudes_of(base, chosen)
    )
    own = tangent[:, list(chosen.atoms)]
    unit, _ = np.linalg.qr(jacobian)
    lone = own - unit @ (unit.T @ own)
    p = len(chosen.z)
    variance = np.einsum("mi,ij,mj->m", lone, chosen.covariance[p:, p:], lone)
    if case.verdict.status in ("named", "cannot_tell"):
        return np.zeros(len(residual)), np.sqrt(np.maximum(variance, 0))
    used_up = np.concatenate([jacobian, own], axis=1)
    smooth, unsure = located(base.generic, used_up, residual)
    return smooth, np.sqrt(np.maximum(variance + unsure, 0))


def _closures(case: _Case, rows, generator) -> dict[str, Closure]:
    base, verdict = case.base, case.verdict
    found = {}
    p = base.layout.size
    for channel, parts in rows.items():
        observed = base.prepared.observed[channel]
        noise = base.noise[channel]
        keep = ~noise.outlier
        extended = parts["base"] if verdict.status == "unknown" else parts["extended"]
        found[channel] = closure_of(
            (observed - parts["base"])[keep], (observed - extended)[keep],
            (noise.std**2)[keep], (p, p + len(verdict.chosen.atoms)),
            base.prepared.run[keep], noise.inflation, generator,
        )  # fmt: skip
    return found


def _gap_record(closure: Closure, verdict: Verdict) -> dict:
    silent = verdict.status in ("none", "unknown")
    closed = 0.0 if silent else closure.closed
    interval = [closure.low, closure.high]
    return {
        "rms": closure.rms,
        "resolvable": closure.resolvable and verdict.status != "none",
        "closed": closed if closed is None else float(np.clip(closed, 0.0, 1.0)),
        "closed_ci": [0.0, 0.0] if silent else interval,
        "remaining_rms": closure.rms if silent else closure.remaining,
    }


def _noise_record(case: _Case) -> dict:
    base = case.base
    flags = dict.fromkeys(f for n in base.noise.values() for f in n.flags)
    record = {c: float(np.median(n.std)) for c, n in base.noise.items()}
    name = "alpha" if base.prepared.mode == "y" else "sigma_x"
    sources = dict.fromkeys(n.source for n in base.noise.values())
    return record | {
        name: base.slip_noise,
        f"{name}_source": base.prepared.slip_source,
        "source": "; ".join(sources),
        "flags": list(flags),
        "inflation": max(n.inflation for n in base.noise.values()),
        "outliers": sum(int(n.outlier.sum()) for n in base.noise.values()),
    }


_NOISE_NAMES = {"autocorrelated": "noise_autocorrelated", "outliers": "outliers"}


def _verdict_record(case: _Case) -> dict:
    verdict = case.verdict
    status, effects = verdict.status, list(verdict.effects)
    if status == "none":
        flags = [f for n in case.base.noise.values() for f in n.flags]
        effects = list(
            dict.fromkeys(_NOISE_NAMES[f] for f in flags if f in _NOISE_NAMES)
        )
        status = "named" if effects else "none"
    return {
        "status": status,
        "effects": effects,
        "probability": verdict.probability,
        "also_possible": list(verdict.also_possible),
    }


def _where(case: _Case, rows) -> list[dict]:
    base = case.base
    residual, *_ = base.at_null
    main = base.prepared.channels[0]
    found = regions(base, residual[: base.prepared.n], rows[main]["gap"], 1.0)
    return [region._asdict() for region in found]


def _candidates(case: _Case, generator, most: int = 10) -> list[dict]:
    weighed = case.weighed
    total = {
        k: v + weighed.unknown_beside.get(k, 0.0) for k, v in weighed.sets.items() if k
    }
    ranked = sorted(total, key=total.get, reverse=True)[:most]
    return [_candidate(case, key, total[key], generator) for key in ranked] + (
        [{"effects": ["unknown"], "family": "unknown",
          "probability": weighed.unknown_alone, "parameters": {}, "z": None,
          "z_given_rivals": None, "closed": 0.0, "closed_ci": [0.0, 0.0]}]
        if weighed.unknown_alone > 1e-3 else []
    )  # fmt: skip


def _candidate(case: _Case, key, probability: float, generator) -> dict:
    base, hypothesis = case.base, case.weighed.best_of[key]
    p, parameters = len(hypothesis.z), {}
    spread = np.sqrt(np.maximum(np.diag(hypothesis.covariance)[p:], 0))
    spread = spread * np.sqrt(_widening(case, hypothesis))
    scale = np.asarray(base.design.prior_scale)
    effects = [base.atoms[k].effect for k in hypothesis.atoms]
    for j, (k, effect) in enumerate(zip(hypothesis.atoms, effects, strict=True)):
        parameters[f"{effect.id}: {effect.parameter}"] = {
            "value": float(hypothesis.amplitude[j] * scale[k]),
            "std": float(spread[j] * scale[k]),
            "unit": effect.unit,
        }
    null = case.weighed.best_of[()]
    main = base.prepared.channels[0]
    observed, noise = base.prepared.observed[main], base.noise[main]
    before = base.forces(null.z, np.zeros(len(base.atoms)))[main]
    after = base.forces(hypothesis.z, amplitudes_of(base, hypothesis))[main]
    keep = ~noise.outlier
    closure = closure_of(
        (observed - before)[keep], (observed - after)[keep], (noise.std**2)[keep],
        (base.layout.size, base.layout.size + len(key)), base.prepared.run[keep],
        noise.inflation, generator,
    )  # fmt: skip
    ratio = hypothesis.amplitude / np.maximum(spread, 1e-12)
    return {
        "effects": list(key),
        "family": " + ".join(dict.fromkeys(e.family for e in effects)),
        "probability": probability,
        "parameters": parameters,
        "z": max((case.search.score.get(e.id, 0.0) for e in effects), key=abs),
        "z_given_rivals": float(np.min(np.abs(ratio))),
        "closed": closure.closed,
        "closed_ci": [closure.low, closure.high],
    }


def _widening(case: _Case, hypothesis: Hypothesis) -> float:
    """Factor on the variance of amplitudes: what a hypothesis leaves is larger than
    the noise, and neighbours in time agree, where it does not explain everything."""
    base = case.base
    prepared, n = base.prepared, base.prepared.n
    residual = base.linearised(hypothesis.z, amplitudes_of(base, hypothesis)).residual
    rows_each = max(
        correlation(residual[k * n : (k + 1) * n], prepared.time, prepared.run)
        for k in range(len(prepared.channels))
    )
    return max(float(np.mean(residual**2)), 1.0) * rows_each


def _resolution(case: _Case) -> dict:
    """Generic remainder that would be seen four times in five, rms [N]."""
    base = case.base
    main = base.prepared.channels[0]
    scale = np.asarray(base.design.scale[main])[: base.prepared.n]
    directions = min(base.generic.smooth.shape[1], 40)
    needed = np.sqrt(2.5 * np.sqrt(2 * directions) / base.prepared.n)
    seen = {effect: 3.3 * abs(value) for effect, value in _smallest_seen(case).items()}
    return {
        "smallest unlisted remainder that would have been seen": float(
            np.median(scale) * needed
        ),
        "smallest_effects": seen,
    }


def _smallest_seen(case: _Case) -> dict[str, float]:
    """One standard deviation of each effect's amplitude on this data, own units."""
    base, left = case.base, case.search.projected
    size, found = np.linalg.norm(left, axis=0), {}
    for k in case.search.testable:
        effect = base.atoms[k].effect
        if effect.id not in found and size[k] > 1e-6 and not effect.singular:
            found[effect.id] = float(np.asarray(base.design.prior_scale)[k] / size[k])
    return found


def _base_parameters(base: Base, z) -> dict[str, float]:
    values = base.layout.natural(z)
    return {name: float(np.asarray(v).ravel()[0]) for name, v in values.items()}


def _all_rows(case: _Case, data: TireData, rig, rows):
    """The rows of the whole file, NaN where masked: {channel: {name: (n,)}}."""
    base = case.base
    if base.prepared.data is not data:
        rows = _on_everything(case, data, rig, rows)
    found = {}
    for channel, parts in rows.items():
        found[channel] = {}
        for name, values in parts.items():
            full = np.full(len(data), np.nan)
            full[data.used] = values
            found[channel][name] = full
    return found


def _on_everything(case: _Case, data: TireData, rig, rows):
    """Forces of both fits on every row; the located gap between the thinned rows is
    interpolated in their order."""
    from tirefit.diagnosis.base import on_rows

    base, verdict = case.base, case.verdict
    whole = on_rows(base, prepare(data, rig, base.prepared.channels), rig)
    null = case.weighed.best_of[()]
    before = whole.forces(null.z, np.zeros(len(base.atoms)))
    after = whole.forces(verdict.chosen.z, amplitudes_of(base, verdict.chosen))
    kept = np.flatnonzero(base.prepared.data.used[data.used])
    every, found = np.arange(data.n), {}
    for channel, parts in rows.items():
        rest = parts["gap"] - (parts["extended"] - parts["base"])
        gap = after[channel] - before[channel] + np.interp(every, kept, rest)
        found[channel] = {
            "base": before[channel], "extended": after[channel], "gap": gap,
            "gap_std": np.interp(every, kept, parts["gap_std"]),
        }  # fmt: skip
    return found
