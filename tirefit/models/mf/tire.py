"""The whole tire: pure and combined slip of one sample."""

from collections.abc import Collection, Mapping, Set
from functools import partial
from operator import neg

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.arrays import Scalar
from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.models.brush import resultant
from tirefit.models.mf import fields
from tirefit.models.mf.aligning import Aligning
from tirefit.models.mf.lateral import Lateral
from tirefit.models.mf.longitudinal import Longitudinal
from tirefit.models.mf.moments import Overturning, Rolling
from tirefit.models.mf.similarity import elliptic_forces, similar_forces
from tirefit.padding import pad_rows, padded_size
from tirefit.params import specs, with_values
from tirefit.slip import LOCKED, kappa_from_sigma, sigma_from_kappa

WEIGHTS = {"fx": ("RBX1", "RCX1"), "fy": ("RBY1", "RCY1")}
"""Force -> coefficients without which its weighting function is one."""
COMBINATIONS = ("none", "similarity", "ellipse")
"""Names of the ways to combine both slips, see :func:`mf_tire`."""


class MFTire(AbstractTire):
    """Magic Formula 5.2, 6.1 or 6.2 in steady state, without turn slip.

    Every coefficient is a parameter under its name in a ``.tir`` file. 6.1 and 6.2 have
    the same forces and moments. In pure slip the equations of combined slip apply with
    the other slip zero. Inputs are not limited to the range in which the coefficients
    were determined. ``overturning`` and ``rolling`` are None if M_x or M_y is unknown.

    ``starred``: the equations take tan(alpha) and sin(gamma), as in the book (4.E3,
    4.E4), instead of the angles, as in MF-Tyre.
    The vertical shifts decrease with scaled friction (LMUX, LMUY, LMUV) as the friction does:
    A_mu of (4.E8) is 1, as in the software of TNO that reads and writes the files; the book
    recommends 10.
    ``similarity``: forces in combined slip by :mod:`.similarity`, not by weighting functions.
    ``ellipse``: both forces in combined slip by the friction ellipse.
    ``lacks``: forces that the tire does not have; they are None.
    """

    nominal: fields.Nominal = fields.Nominal()
    scaling: fields.Scaling = fields.Scaling()
    longitudinal: Longitudinal = Longitudinal()
    lateral: Lateral = Lateral()
    aligning: Aligning = Aligning()
    overturning: Overturning | None = None
    rolling: Rolling | None = None
    version: str = eqx.field(static=True, default="6.1")
    starred: bool = eqx.field(static=True, default=False)
    similarity: tuple[str, ...] = eqx.field(static=True, default=())
    ellipse: bool = eqx.field(static=True, default=False)
    lacks: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def needs(self) -> tuple[str, ...]:
        return ("v",) if self.scaling.LMUV != 0 else ()

    @property
    def unweighted(self) -> tuple[str, ...]:
        """Forces whose combined slip is not by weighting functions."""
        return tuple(WEIGHTS) if self.ellipse else self.similarity

    def __call__(self, inputs: TireInputs) -> TireForces:
        scale, nominal = self.scaling, self.nominal
        at = self.point(inputs)
        fz0 = nominal.FNOMIN * scale.LFZO
        along, along_stiffness = self.longitudinal.pure(at, scale)
        side = self.lateral.pure(at, scale, fz0)
        side_weight = fields.weighting(self.lateral.weight(at, scale))
        load = jnp.where(inputs.fz > 0, at.fz, 0.0)
        fx: Scalar = fields.weighting(self.longitudinal.weight(at, scale)) * along
        fy: Scalar = side_weight * side.force + self.lateral.induced(at, scale, side.mu)
        # The trail acts on the lateral force without the part induced by kappa
        # (4.E74), in MF 6 on that of an upright wheel.
        upright, upright_at = side, at
        if at.camber_stiffness:
            upright_at = at._replace(gamma=0.0 * at.gamma)
            upright = self.lateral.pure(upright_at, scale, fz0)
        turned: Scalar = side_weight * upright.force
        if self.unweighted:
            method = elliptic_forces if self.ellipse else similar_forces
            combined = partial(method, self.longitudinal, self.lateral)
            both = combined(at, scale, fz0)
            fx = both[0] if "fx" in self.unweighted else fx
            if "fy" in self.unweighted:
                fy, turned = both[1], combined(upright_at, scale, fz0)[1]
        fx, fy, turned = load * fx, load * fy, load * turned
        slip = fields.ratio(along_stiffness, side.stiffness) * at.kappa
        if "fx" in self.lacks:  # the moment is then that of a freely rolling wheel
            fx, slip = 0.0 * fx, 0.0 * slip
        mz = (
            load * self.aligning.residual(at, scale, nominal, side, slip)
            - self.aligning.trail(at, scale, nominal, slip) * turned
            + self.aligning.arm(at, scale, nominal, fy) * fx
        )
        mx = my = None
        if self.overturning is not None:
            mx = -self.overturning.moment(at, scale, nominal, load, fy)
        if self.rolling is not None:
            my = -self.rolling.moment(at, scale, nominal, load, fx, inputs.v)
        # From ISO-W to the canonical signs of tirefit.slip.
        given = TireForces(-fx, -fy, -mz, mx, my)
        # M_x depends on F_y.
        lacks = (*self.lacks, *(["mx"] if "fy" in self.lacks else ()))
        return given._replace(**dict.fromkeys(lacks))

    def point(self, inputs: TireInputs) -> fields.Point:
        """The operating point in ISO-W axes; a load of zero becomes FNOMIN."""
        scale, nominal = self.scaling, self.nominal
        fz = jnp.where(inputs.fz > 0, inputs.fz, nominal.FNOMIN)
        fz0 = nominal.FNOMIN * scale.LFZO
        kappa = -kappa_from_sigma(inputs.sigma_x)
        tan_alpha = jnp.tan(inputs.alpha)
        pressure = jnp.where(inputs.pressure > 0, inputs.pressure, nominal.INFLPRES)
        sliding = inputs.v * resultant(kappa, tan_alpha) / nominal.LONGVL
        fall = 1 / (1 + scale.LMUV * sliding)
        return fields.Point(
            kappa, tan_alpha if self.starred else inputs.alpha, fields.cos_arctan(tan_alpha),
            jnp.sin(inputs.gamma) if self.starred else inputs.gamma, inputs.gamma, fz,
            (fz - fz0) / fz0, (pressure - nominal.NOMPRES) / nominal.NOMPRES,
            scale.LMUX * fall, scale.LMUY * fall, camber_stiffness=self.version != "5.2",
            starred=self.starred,
        )  # fmt: skip


def frictions(tire: MFTire, inputs: TireInputs) -> dict[str, np.ndarray]:
    """Friction coefficients D / F_z of F_x and F_y at inputs of arrays (n,)."""
    size = len(np.asarray(inputs.fz))
    padded = TireInputs(*(pad_rows(column, padded_size(size, 1024)) for column in inputs))
    return {force: np.asarray(mu)[:size] for force, mu in _all_frictions(tire, padded).items()}


def _frictions(tire: MFTire, inputs: TireInputs) -> dict[str, Scalar]:
    at, fz0 = tire.point(inputs), tire.nominal.FNOMIN * tire.scaling.LFZO
    side = tire.lateral.pure(at, tire.scaling, fz0)
    return {"fx": tire.longitudinal.friction(at, tire.scaling), "fy": side.mu}


_all_frictions = jax.jit(jax.vmap(_frictions, (None, 0)))

OTHER_SIDE = frozenset(("alpha", "gamma", "fy", "mz", "mx"))
"""Fields of a convention that change sign if a tire is mirrored in the plane of its
wheel, as on the other side of the vehicle."""


class Mirrored(AbstractTire):
    """A tire with the sign of the fields ``turned`` of ``slip.Convention`` reversed: on
    the other side of the vehicle, or in other axes."""

    tire: AbstractTire
    turned: frozenset[str] = eqx.field(static=True, default=OTHER_SIDE)

    def __call__(self, inputs: TireInputs) -> TireForces:
        forces = self.tire(turned_inputs(inputs, self.turned))
        return turned_forces(forces, self.turned)


class Pair(AbstractTire):
    """The two tires of an axle, as one: each carries half of the load, and one is the
    mirror image of the other, so that conicity and ply steer cancel."""

    tire: AbstractTire

    def __call__(self, inputs: TireInputs) -> TireForces:
        half = inputs._replace(fz=inputs.fz / 2)
        return jax.tree.map(jnp.add, self.tire(half), Mirrored(self.tire)(half))


def turned_inputs(inputs: TireInputs, turned: Set[str]) -> TireInputs:
    """Inputs with the sign of ``turned`` (``slip``, ``alpha``, ``gamma``) reversed; a
    wheel that spins at kappa = -1 or faster becomes a locked one."""
    names = turned & {"alpha", "gamma"}
    changed = {name: -getattr(inputs, name) for name in names}
    if "slip" in turned:
        kappa = jnp.minimum(-kappa_from_sigma(inputs.sigma_x), kappa_from_sigma(LOCKED))
        changed["sigma_x"] = sigma_from_kappa(kappa)
    return inputs._replace(**changed)


def turned_forces(forces: TireForces, turned: Set[str]) -> TireForces:
    """Forces with the sign of those in ``turned`` reversed; None stays None."""
    names = turned & set(forces._fields)
    changed = {n: jax.tree.map(neg, getattr(forces, n)) for n in names}
    return forces._replace(**changed)


def mf_tire(
    version: str, values: Mapping[str, float], *, starred: bool = False,
    combination: str | None = None, lacks: Collection[str] = (),
) -> MFTire:  # fmt: skip
    """The tire of a set of coefficients.

    Args:
        version: "5.2", "6.1" or "6.2".
        values: coefficients by their names in a ``.tir`` file, SI units; other names
            are ignored, and missing coefficients have no effect. Without any of QSX1 to
            QSX14 there is no M_x, without any of QSY1 to QSY8 no M_y.
        starred: see :class:`MFTire`.
        combination: ``none`` for weighting functions, which are one if their coefficients are
            missing; ``similarity`` and ``ellipse`` for :mod:`.similarity`; None for similarity of
            the forces whose coefficients are missing.
        lacks: forces that the values do not describe; they are None.

    Raises:
        ValueError: the version or the combination is none of these.
    """
    if version not in ("5.2", "6.1", "6.2"):
        raise ValueError(f"Magic Formula {version}: 5.2, 6.1 and 6.2 are known")
    if combination not in (None, *COMBINATIONS):
        raise ValueError(f"combination {combination!r} is none of {', '.join(COMBINATIONS)}")
    absent = [f for f, keys in WEIGHTS.items() if not all(k in values for k in keys)]
    similar = {None: absent, "similarity": list(WEIGHTS)}.get(combination, [])
    ellipse = combination == "ellipse"
    # Both methods need both pure forces.
    if set(WEIGHTS) & set(lacks):
        similar, ellipse = [], False
    begin = {key[:3] for key in values}
    tire = MFTire(
        overturning=Overturning() if "QSX" in begin else None,
        rolling=Rolling() if "QSY" in begin else None,
        version=version,
        starred=starred,
        similarity=tuple(similar),
        ellipse=ellipse,
        lacks=tuple(lacks),
    )
    if "NOMPRES" in values:
        values = {"INFLPRES": values["NOMPRES"], **values}
    return with_values(tire, {k: values[k] for k in specs(tire) if k in values})


def curvatures(tire: MFTire, inputs: TireInputs) -> dict[str, Float[Array, " n"]]:
    """Largest curvature factor E of each force of the tire (n,), of its pure curve and of its
    weighting function, before the limit to one.

    At E > 1 the curve bends back. Some programs limit E to one, as
    :func:`~tirefit.models.magic_formula.bent` does, others do not. An E without effect on a
    sample (zero argument, weight without shape, zero load) counts as zero. That of M_z does not
    include those of F_x and F_y, on which M_z also depends.
    """
    arrays = [jnp.atleast_1d(jnp.asarray(value, float)) for value in inputs]
    return _largest_of_all(tire, TireInputs(*jnp.broadcast_arrays(*arrays)))


def _largest(tire: MFTire, inputs: TireInputs) -> dict[str, Scalar]:
    """:func:`curvatures` of one sample."""
    at, scale = tire.point(inputs), tire.scaling
    fz0 = tire.nominal.FNOMIN * scale.LFZO
    side = tire.lateral.pure(at, scale, fz0)
    _, stiffness = tire.longitudinal.pure(at, scale)
    slip = fields.ratio(stiffness, side.stiffness) * at.kappa

    def acting(curve: fields.Curve, shape: Scalar = 1.0) -> Array:
        acts = (curve.x * shape != 0) & (inputs.fz > 0)
        return jnp.where(acts, curve.curvature, 0.0)

    def weighting(force: str, weight: fields.Weight) -> Scalar:
        if force in tire.unweighted:
            return 0.0
        # Without the other slip the weight is one for any E.
        other = at.alpha if force == "fx" else at.kappa
        return acting(fields.Curve(other, weight.curve.curvature), weight.shape)

    along, across = tire.longitudinal, tire.lateral
    weights = {"fx": along.weight(at, scale), "fy": across.weight(at, scale)}
    largest = {
        "fx": acting(along.curve(at, scale)),
        "fy": acting(side.curve),
        "mz": acting(tire.aligning.curve(at, scale, slip), tire.aligning.QDZ1),
    }
    for force, weight in weights.items():
        largest[force] = jnp.maximum(largest[force], weighting(force, weight))
    return {force: value for force, value in largest.items() if force not in tire.lacks}


_largest_of_all = jax.jit(jax.vmap(_largest, (None, 0)))
