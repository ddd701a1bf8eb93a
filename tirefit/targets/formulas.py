"""Tire formulas of simulators, in the signs of each simulator.

A :class:`Formula` is the force that a simulator computes from the parameters of its file.
:mod:`tirefit.targets.refit` fits these parameters to an exported tire.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from tirefit.arrays import Numbers, Scalar
from tirefit.models import AbstractTire, CombinedMagicFormula, TireInputs
from tirefit.models.magic_formula import MagicFormula, bent
from tirefit.models.mf import MFTire
from tirefit.slip import CONVENTIONS, Convention, sigma_from_kappa
from tirefit.targets.program import Program, traced
from tirefit.targets.tire import ALWAYS, INPUTS, sign_of

Values = Mapping[str, Any]
"""Parameter -> value."""


class Curves(NamedTuple):
    """A tire at a load, from which the parameters of a formula start."""

    x: tuple[float, ...]
    """B, C, D, E of the Magic Formula of the two pure slips; exact if the tire is a Magic
    Formula."""
    y: tuple[float, ...]
    load: float  # the load [N]
    fall: float  # exponent by which the friction of F_y falls with load
    weights: Mapping[str, float]
    """Coefficients of combined slip of a Magic Formula 5.2 or 6, by name."""


@dataclass(frozen=True, eq=False)
class Formula:
    """The tire formula of a simulator."""

    outputs: tuple[str, ...]  # the forces that it gives
    signs: Convention  # of its slips and forces, as in :data:`tirefit.slip.CONVENTIONS`
    forces: Callable[[Values, Any, Any, Any], tuple[Any, ...]]
    """Parameters, kappa, alpha [rad] and load [N] to the forces [N]."""
    start: Callable[[Curves], dict[str, float]]  # parameters for a tire, by formula
    stages: Mapping[str, Mapping[str, tuple[float, float]]]
    """In order, ``fx`` and ``fy`` of pure slip and ``both`` of combined slip, each with the bounds
    of the parameters that least squares fits to it. A force without a stage keeps the parameters
    of ``start``."""
    of_load: tuple[str, ...] = ()  # parameters of a stage that one load does not determine
    loss: tuple[str, ...] = ()  # sentences on what the formula cannot hold of any tire

    def canonical(
        self, values: Values, kappa: Numbers, alpha: Numbers, fz: Numbers
    ) -> tuple[Any, ...]:
        """Forces [N] at canonical slips, in canonical signs."""
        signs = self.signs
        forces = self.forces(values, signs.slip * kappa, signs.alpha * alpha, fz)
        pairs = zip(self.outputs, forces, strict=True)
        return tuple(getattr(signs, name) * force for name, force in pairs)

    def program(self, values: Values, convention: str) -> Program:
        """The formula with these values as a program in a sign convention."""
        slip, side, load = (sign_of(convention, name) for name in INPUTS[:ALWAYS])

        def function(kappa: Numbers, alpha: Numbers, fz: Numbers) -> tuple[Numbers, ...]:
            forces = self.canonical(values, slip * kappa, side * alpha, load * fz)
            pairs = zip(self.outputs, forces, strict=True)
            return tuple(sign_of(convention, name) * force for name, force in pairs)

        return traced(function, INPUTS[:ALWAYS], self.outputs)


def magic_formula_of(
    model: AbstractTire,
) -> tuple[tuple[float, ...], tuple[float, ...], dict[str, float]] | None:
    """B, C, D, E of both pure slips and the weights of a Magic Formula tire at its
    nominal load, upright and at nominal pressure; None for another tire."""
    if isinstance(model, CombinedMagicFormula):
        along = _floats(model.Bx, model.Cx, model.Dx, model.Ex)
        return along, _floats(model.By, model.Cy, model.Dy, model.Ey), {}
    if not isinstance(model, MFTire) or model.lacks or model.unweighted:
        return None
    scale, fz0 = model.scaling, model.nominal.FNOMIN * model.scaling.LFZO
    at = model.point(TireInputs(0.0, 0.0, fz0))
    x, y = model.longitudinal, model.lateral
    mu, shape = x.friction(at, scale), x.PCX1 * scale.LCX
    slope = x.stiffness(at, scale) / (shape * mu)
    along = _floats(slope, shape, mu, x.PEX1 * scale.LEX)
    side, shape = y.pure(at, scale, fz0), y.PCY1 * scale.LCY
    # In ISO-W axes the cornering stiffness is negative.
    slope = abs(side.stiffness) / (shape * side.mu)
    names = "RBX1 RBX2 RCX1 REX1 RHX1 RBY1 RBY2 RBY3 RCY1 REY1 RHY1 RVY1 RVY4 RVY5 RVY6"
    weights = {n: float(getattr(y if n[2] == "Y" else x, n)) for n in names.split()}
    weights["PHX1"] = float(x.PHX1 * scale.LHX)
    return along, _floats(slope, shape, side.mu, y.PEY1 * scale.LEY), weights


def _floats(*coefficients: Scalar) -> tuple[float, ...]:
    b, c, d, e = map(float, coefficients)
    return b, c, d, min(e, 1.0)  # limit E as `bent` does; simulators do not


_SHAPE, _CURVATURE, _WEIGHT = (0.3, 3.0), (-20.0, 1.0), (-200.0, 200.0)
_FRICTION, _SLOPE = (0.01, 5.0), (0.01, 1000.0)
"""Bounds of C, E, weights of combined slip, friction and slope over load."""


def _commonroad_forces(
    p: Values, kappa: Numbers, alpha: Numbers, fz: Numbers
) -> tuple[Numbers, Numbers]:
    """``tire_model.py`` of commonroad-vehicle-models 3.0.2 without camber: kappa is
    positive when braking, which pure slip negates and combined slip does not. p_vx1,
    which is zero, is inside the sine."""
    drive = -kappa + p["p_hx1"]
    slope = p["p_kx1"] / (p["p_cx1"] * p["p_dx1"])
    along = p["p_dx1"] * fz * jnp.sin(p["p_cx1"] * bent(slope * drive, p["p_ex1"]))
    slope = p["p_ky1"] / (p["p_cy1"] * p["p_dy1"])
    across = p["p_dy1"] * fz * jnp.sin(p["p_cy1"] * bent(slope * alpha, p["p_ey1"]))

    def weight(axis: str, slope: Numbers, slip: Numbers, shift: Numbers) -> Numbers:
        shape, curvature = p[f"r_c{axis}1"], p[f"r_e{axis}1"]
        both = (bent(slope * s, curvature) for s in (slip + shift, shift))
        top, bottom = (jnp.cos(shape * angle) for angle in both)
        return top / bottom

    slope = p["r_bx1"] * jnp.cos(jnp.arctan(p["r_bx2"] * kappa))
    along = along * weight("x", slope, alpha, p["r_hx1"])
    slope = p["r_by1"] * jnp.cos(jnp.arctan(p["r_by2"] * (alpha - p["r_by3"])))
    across = across * weight("y", slope, kappa, p["r_hy1"])
    induced = p["p_dy1"] * fz * p["r_vy1"] * jnp.cos(jnp.arctan(p["r_vy4"] * alpha))
    induced = induced * jnp.sin(p["r_vy5"] * jnp.arctan(p["r_vy6"] * kappa))
    return along, across + induced


def _commonroad_start(curves: Curves) -> dict[str, float]:
    (bx, cx, dx, ex), (by, cy, dy, ey) = curves.x, curves.y
    given = curves.weights
    values = {
        "p_cx1": cx, "p_dx1": dx, "p_ex1": ex, "p_kx1": bx * cx * dx,
        "p_hx1": given.get("PHX1", 0.0), "p_vx1": 0.0,
        "p_cy1": cy, "p_dy1": dy, "p_ey1": ey, "p_ky1": -by * cy * dy,
        # A tire without weights gets those of CommonRoad's, over the slips of both peaks.
        "r_bx1": 0.6 * by * cy, "r_bx2": -0.7 * bx * cx, "r_cx1": 1.1, "r_ex1": 0.0,
        "r_hx1": 0.0, "r_by1": 0.4 * bx * cx, "r_by2": 0.4 * by * cy, "r_by3": 0.0,
        "r_cy1": 1.1, "r_ey1": 0.0, "r_hy1": 0.0, "r_vy1": 0.0, "r_vy4": 10.0,
        "r_vy5": 1.9, "r_vy6": 10.0,
    }  # fmt: skip
    # Its combined slip uses kappa positive when braking, so odd terms change sign.
    turned = {"RHY1": -1.0, "RVY6": -1.0}
    for name, value in given.items():
        value = min(value, 1.0) if name in ("REX1", "REY1") else value
        if name[0] == "R":
            values[f"r_{name[1:].lower()}"] = turned.get(name, 1.0) * value
    # Parameters that act only with camber.
    names = "p_dx3 p_dy3 p_hy1 p_hy3 p_vy1 p_vy3 r_vy3"
    return values | dict.fromkeys(names.split(), 0.0)


COMMONROAD = Formula(
    outputs=("fx", "fy"),
    signs=CONVENTIONS["iso-w"]._replace(
        slip=1,
        description="kappa = 1 - R omega / u, positive when braking; F_x positive when"
        " driving; ISO 8855 alpha: F_y < 0 for alpha > 0, p_ky1 < 0; F_z > 0",
    ),
    forces=_commonroad_forces,
    start=_commonroad_start,
    stages={
        "fx": {"p_cx1": _SHAPE, "p_dx1": _FRICTION, "p_ex1": _CURVATURE, "p_kx1": _SLOPE},
        "fy": {"p_cy1": _SHAPE, "p_dy1": _FRICTION, "p_ey1": _CURVATURE, "p_ky1": (-1000.0, -0.01)},
        # Shifts are those of a Magic Formula, or zero so that there is no force at rest.
        "both": {
            **{"r_bx1": _WEIGHT, "r_bx2": _WEIGHT, "r_cx1": _SHAPE, "r_ex1": _CURVATURE},
            **{"r_by1": _WEIGHT, "r_by2": _WEIGHT, "r_cy1": _SHAPE, "r_ey1": _CURVATURE},
        },
    },
    loss=(
        "its forces are proportional to F_z; it has no offsets of F_y, no vertical offset"
        " of F_x (p_vx1 is inside the sine) and no camber",
    ),
)
"""CommonRoad's reduced PAC2002, also that of Gym-Khana's STD and MB."""


PACEJKA = Formula(
    outputs=("fy",),
    signs=CONVENTIONS["braking"]._replace(
        description="alpha = delta - atan(v_y / v_x), so F_y > 0 for alpha > 0"
    ),
    forces=lambda p, kappa, alpha, fz: (MagicFormula(**p).pure(alpha, fz),),
    start=lambda curves: dict(zip("BCDE", curves.y, strict=True)),
    stages={"fy": {"B": (0.01, 500.0), "C": _SHAPE, "D": _FRICTION, "E": _CURVATURE}},
    loss=("it has no F_x, which is the command; F_y is proportional to F_z",),
)
"""F_y = F_z D sin(C arctan(B alpha - E (B alpha - arctan B alpha)))."""


def _slipx_forces(
    p: Values, kappa: Numbers, alpha: Numbers, fz: Numbers
) -> tuple[Numbers, Numbers]:
    """``tyre.hpp`` of slipx 0.2.0; its tier L2 takes F_x as a demand and reports kappa =
    F_x / c_kappa."""
    fz0 = p["nominal_load"]
    share = jnp.power(jnp.maximum(fz, 1e-9 * fz0) / fz0, 1 - p["k_mu"])
    most_x, most_y = p["mu_x0"] * fz0 * share, p["mu_y0"] * fz0 * share
    slope = p["c_alpha"] / (p["C"] * p["mu_y0"] * fz0)
    along = p["c_kappa"] * share * kappa / most_x
    across = -jnp.sin(p["C"] * bent(slope * alpha, p["E"]))
    size = jnp.sqrt(jnp.maximum(along**2 + across**2, 1.0))
    return most_x * along / size, most_y * across / size


def _slipx_start(curves: Curves) -> dict[str, float]:
    (bx, cx, dx, _), (by, cy, dy, ey) = curves.x, curves.y
    load = curves.load
    return {
        "nominal_load": load, "c_alpha": by * cy * dy * load, "mu_y0": dy, "C": cy, "E": ey,
        "k_mu": curves.fall, "c_kappa": bx * cx * dx * load, "mu_x0": dx,
    }  # fmt: skip


SLIPX = Formula(
    outputs=("fx", "fy"),
    signs=CONVENTIONS["iso-w"],
    forces=_slipx_forces,
    start=_slipx_start,
    stages={
        "fy": {
            "c_alpha": (1e-3, 1e6),
            "mu_y0": (0.01, 3.0),
            "C": (1.001, 2.5),
            "E": (-5.0, 1.0),
            "k_mu": (0.0, 1.0),
        }
    },  # fmt: skip
    of_load=("k_mu",),
    loss=(
        "SlipX takes F_x as a demand and limits both forces by an ellipse: c_kappa is the"
        " slope at zero slip and mu_x0 the peak of F_x at the nominal load; it has no"
        " curves of F_x and of combined slip",
        "tier L2 of SlipX needs relaxation.sigma, which a tire with relaxation gives",
    ),
)
"""MF-lite of SlipX: F_y of pure slip, friction that falls with load, an ellipse."""


def _gazebo_forces(p: Values, kappa: Numbers, alpha: Numbers, fz: Numbers) -> tuple[Numbers, ...]:
    """Gazebo's WheelSlip with a friction pyramid: the slip velocity over R omega is the
    slip compliance times the force over the normal force of the plugin."""
    slip_x = sigma_from_kappa(jnp.minimum(kappa, 0.999))
    slip_y = jnp.tan(alpha) * (1 + slip_x)
    return tuple(
        jnp.clip(slip * p["wheel_normal_force"] / p[compliance], -p[mu] * fz, p[mu] * fz)
        for slip, compliance, mu in (
            (slip_x, "slip_compliance_longitudinal", "mu2"),
            (slip_y, "slip_compliance_lateral", "mu"),
        )
    )


def _gazebo_start(curves: Curves) -> dict[str, float]:
    (bx, cx, dx, _), (by, cy, dy, _) = curves.x, curves.y
    return {
        "slip_compliance_lateral": 1 / (by * cy * dy),
        "slip_compliance_longitudinal": 1 / (bx * cx * dx),
        "wheel_normal_force": curves.load,
        "mu": dy,
        "mu2": dx,
    }


GAZEBO = Formula(
    outputs=("fx", "fy"),
    signs=CONVENTIONS["braking"]._replace(description="its parameters have no sign"),
    forces=_gazebo_forces,
    start=_gazebo_start,
    stages={},
    loss=(
        "the force is linear in slip up to Coulomb friction, separately in each direction:"
        " slip_compliance is the inverse of the slope at zero slip, mu the peak, at the"
        " normal force of the file",
        "replace WHEEL by the name of the link of each wheel",
    ),
)
"""Force-dependent slip of ODE as Gazebo's WheelSlip system sets it."""
