"""What is said of one file: the document of a diagnosis and its rows."""

import importlib.metadata
from dataclasses import asdict

import numpy as np

from tirefit.diagnosis.base import Base, at_measured_slip, on_rows
from tirefit.diagnosis.basis import located, without
from tirefit.diagnosis.case import Case
from tirefit.diagnosis.closure import Closure, closure_of
from tirefit.diagnosis.effects import NOISE_EFFECTS
from tirefit.diagnosis.forecast import confusion, next_measurements
from tirefit.diagnosis.holdout import held_out
from tirefit.diagnosis.noise import correlation
from tirefit.diagnosis.result import SCHEMA, Diagnosis
from tirefit.diagnosis.rows import Prepared
from tirefit.diagnosis.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.shares import closed_by_each
from tirefit.diagnosis.verdict import Verdict, fitted_form, linear_at
from tirefit.diagnosis.where import parameter_map, regions

__all__ = ["document_of"]


def document_of(
    case: Case, whole: Prepared, rig, looked_for, holdout, generator, model, seed
) -> Diagnosis:
    """The verdict on the rows of ``case``, spread over all rows of ``whole``."""
    data = whole.data
    base, verdict = case.base, case.verdict
    prepared = base.prepared
    rows = _rows(case, at_measured_slip(base))
    closures = _closures(case, _rows(case, base), generator)
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
        "map": [cell._asdict() for cell in parameter_map(base)],
        "verdict": _verdict_record(case),
        "candidates": _candidates(case, generator),
        "untestable": case.untestable,
        "resolution": _resolution(case),
        "forecast": confusion(case.search),
        "next_measurement": next_measurements(base, case.search, case.weighed, verdict),
        "base_parameters": _base_parameters(base, base.z),
        "extended_parameters": _base_parameters(base, verdict.chosen.z),
        "settings": {
            "rig": asdict(rig), "effects": looked_for,
            "holdout": [other.source.sha256 for other in holdout],
        },
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
    return Diagnosis(content, _all_rows(case, whole, rig, rows), data, curves)


def _rows(case: Case, at: Base) -> dict[str, dict[str, np.ndarray]]:
    """Base, extended, located gap and its deviation, canonical, used rows.

    Args:
        at: the base fit at the slips that the forces are wanted for.
    """
    base, verdict = case.base, case.verdict
    null = case.weighed.best_of[()]
    before = at.forces(null.z, np.zeros(len(base.atoms)))
    after = at.forces(verdict.chosen.z, amplitudes_of(base, verdict.chosen))
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


def _form_part(case: Case) -> np.ndarray:
    """What another form of the named effects adds to their formulas, whitened (m,)."""
    base, chosen = case.base, case.verdict.chosen
    key = tuple(sorted(chosen.effects))
    if key not in case.weighed.other_form:
        return np.zeros(len(base.prepared.channels) * base.prepared.n)
    return fitted_form(linear_at(base, chosen))


def _smoothed_remainder(case: Case):
    """Whitened generic remainder of the chosen fit and the deviation of the located
    gap, (m,) each; no remainder where a verdict explains all."""
    base, chosen = case.base, case.verdict.chosen
    residual, jacobian, tangent, _ = base.linearised(
        chosen.z, amplitudes_of(base, chosen)
    )
    own = tangent[:, list(chosen.atoms)]
    lone = without(own, jacobian)
    p = len(chosen.z)
    variance = np.einsum("mi,ij,mj->m", lone, chosen.covariance[p:, p:], lone)
    if case.verdict.status in ("named", "cannot_tell"):
        return np.zeros(len(residual)), np.sqrt(np.maximum(variance, 0))
    used_up = np.concatenate([jacobian, own], axis=1)
    smooth, unsure = located(base.generic, used_up, residual)
    return smooth, np.sqrt(np.maximum(variance + unsure, 0))


def _closures(case: Case, rows, generator) -> dict[str, Closure]:
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


def _noise_record(case: Case) -> dict:
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


_NOISE_NAMES = {effect.flag: effect.id for effect in NOISE_EFFECTS if effect.flag}


def _verdict_record(case: Case) -> dict:
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


def _where(case: Case, rows) -> list[dict]:
    base = case.base
    residual, *_ = base.at_null
    main = base.prepared.channels[0]
    found = regions(base, residual[: base.prepared.n], rows[main]["gap"], 1.0)
    return [region._asdict() for region in found]


def _candidates(case: Case, generator, most: int = 10) -> list[dict]:
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


def _candidate(case: Case, key, probability: float, generator) -> dict:
    base, hypothesis = case.base, case.weighed.best_of[key]
    p, parameters = len(hypothesis.z), {}
    spread = np.sqrt(np.maximum(np.diag(hypothesis.covariance)[p:], 0))
    spread = spread * np.sqrt(_widening(case, hypothesis))
    scale = np.asarray(base.design.prior_scale)
    effects = [base.atoms[k].effect for k in hypothesis.atoms]
    for j, (k, effect) in enumerate(zip(hypothesis.atoms, effects, strict=True)):
        parameters[f"{effect.id}: {effect.parameter}"] = {
            "value": float(hypothesis.amplitude[j] * scale[k]),
            # However badly it fits, no less is known of it than beforehand.
            "std": float(min(spread[j], 1.0) * scale[k]),
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


def _widening(case: Case, hypothesis: Hypothesis) -> float:
    """Factor on the variance of amplitudes: what a hypothesis leaves is larger than
    the noise, and neighbours in time agree, where it does not explain everything."""
    base = case.base
    prepared, n = base.prepared, base.prepared.n
    residual = base.residual(hypothesis.z, amplitudes_of(base, hypothesis))
    rows_each = max(
        correlation(residual[k * n : (k + 1) * n], prepared.time, prepared.run)
        for k in range(len(prepared.channels))
    )
    return max(float(np.mean(residual**2)), 1.0) * rows_each


def _resolution(case: Case) -> dict:
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


def _smallest_seen(case: Case) -> dict[str, float]:
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


def _all_rows(case: Case, whole: Prepared, rig, rows):
    """The rows of the whole file, NaN where masked: {channel: {name: (n,)}}."""
    data, found = whole.data, {}
    if case.base.prepared.n < whole.n:
        rows = _on_everything(case, whole, rig, rows)
    for channel, parts in rows.items():
        found[channel] = {}
        for name, values in parts.items():
            full = np.full(len(data), np.nan)
            full[data.used] = values
            found[channel][name] = full
    return found


def _on_everything(case: Case, prepared: Prepared, rig, rows):
    """Forces of both fits on every row; the located gap between the thinned rows is
    interpolated in their order."""
    base, verdict = case.base, case.verdict
    whole = at_measured_slip(on_rows(base, prepared, rig))
    null = case.weighed.best_of[()]
    before = whole.forces(null.z, np.zeros(len(base.atoms)))
    after = whole.forces(verdict.chosen.z, amplitudes_of(base, verdict.chosen))
    kept, every, found = base.prepared.kept, np.arange(prepared.n), {}
    for channel, parts in rows.items():
        rest = parts["gap"] - (parts["extended"] - parts["base"])
        gap = after[channel] - before[channel] + np.interp(every, kept, rest)
        found[channel] = {
            "base": before[channel], "extended": after[channel], "gap": gap,
            "gap_std": np.interp(every, kept, parts["gap_std"]),
        }  # fmt: skip
    return found
