"""Effects of the condition of the tire: inflation, speed, warmth without a
thermometer."""

import jax.numpy as jnp

from tirefit.diagnosis.effects.free_forms import ONE_WAY, Form, over
from tirefit.diagnosis.effects.record import (
    SHARE,
    SYMBOLS,
    Effect,
    multiplies,
    seldom,
)

_FITTED = {"friction": "mu", "stiffness": "cpa2"}


def _worked(share, constants, rows):
    """With the work of sliding so far, under one of its coolings."""
    return 1 + share * rows.work @ jnp.asarray(constants)


def _with_pressure(name: str, size: float, form: float):
    return Effect(
        id=f"{name}_pressure", family=f"{name} x inflation",
        change=multiplies(name, lambda a, _, rows: 1 + a * rows.inflation), scale=size,
        unit="over the range of the file",
        formula=f"{SYMBOLS[name]} (1 + amplitude (p - p0) / range), Besselink 2010",
        means=f"{name} changes with the inflation pressure",
        remedy=f"fit {_FITTED[name]} for each pressure", bounds=(SHARE,),
        needs=("pressure",), forms=over(name, form, "inflation", ONE_WAY),
        looks_like=(f"{name}_drift", f"{name}_temperature"),
        told_apart_by="random order",
    )  # fmt: skip


def _with_work(name: str, size: float):
    return Effect(
        id=f"{name}_warming", family=f"{name} x work", change=multiplies(name, _worked),
        scale=size, unit="over the range of the file",
        formula=f"{SYMBOLS[name]} (1 + amplitude W), dW/dt = |F| v_s - W / cooling",
        means=f"{name} follows the work of sliding: the tire warms up, or wears",
        remedy="measure its temperature; warm the tire up first and pause between runs",
        bounds=(SHARE,), odds=seldom, needs=("work", "v"),
        variants=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        forms=(Form(name, size, lambda rows, u: rows.work),),
        looks_like=(f"{name}_drift", f"{name}_temperature"),
        told_apart_by="random order",
    )  # fmt: skip


STIFFNESS_SPEED = Effect(
    id="stiffness_speed", family="stiffness x speed",
    change=multiplies("stiffness", lambda a, _, rows: (rows.pace / rows.cruise) ** a),
    scale=0.12, formula="c_p a^2 (v / v0)^amplitude",
    means="stiffness is a power of the speed: rubber and belt stiffen",
    remedy="fit cpa2 for each speed", parameter="power", bounds=((-1.5, 1.5),),
    odds=seldom, needs=("speeds",), forms=over("stiffness", 0.05, "v", ONE_WAY),
    looks_like=("relaxation_length", "stiffness_drift"), told_apart_by="speeds",
)  # fmt: skip

EFFECTS = (
    _with_pressure("friction", 0.12, 0.03),
    _with_pressure("stiffness", 0.2, 0.06),
    _with_work("friction", 0.15),
    _with_work("stiffness", 0.2),
    STIFFNESS_SPEED,
)
