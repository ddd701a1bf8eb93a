"""A Python module for MuJoCo: the tire as a function, and its friction."""

import numpy as np

from tirefit.params import parameter_values
from tirefit.slip import CONVENTIONS
from tirefit.targets.code import Draft, compiled, numpy_source

_WIDE, _MANY = 0.2, 3.0
"""Half width of the bounds of the friction for ``mujoco.sysid``: a share of it if no
standard error is known, else a number of standard errors."""

_SNIPPET = '''

def sysid_parameters(geoms):
    """Sliding friction of the geoms of the wheels as a mujoco.sysid.ParameterDict.

    Use it if MuJoCo's contact computes the tire forces. If the function above computes
    them (data.xfrc_applied), the geoms must have no friction.
    """
    from mujoco import sysid

    def write(spec, parameter):
        for name in geoms:
            geom = spec.geom(name)
            geom.friction = [parameter.value[0], *geom.friction[1:]]

    found = sysid.ParameterDict()
    found.add(
        sysid.Parameter(
            "tire_friction", nominal={peak!r}, min_value={low!r}, max_value={high!r},
            modifier=write,
        )
    )
    return found
'''


def mujoco_source(draft: Draft) -> str:
    """A Python module: the forces by NumPy, and the parameter of ``mujoco.sysid``."""
    tire, names = draft.tire, list(draft.forces.outputs)
    at = {"fz": CONVENTIONS[draft.convention].fz * tire.load, "v": tire.speed}
    slip, peak = np.linspace(0.0, 0.95, 191), 0.0
    for force, own in (("fx", "kappa"), ("fy", "alpha")):
        if force in names:
            given = [slip if k == own else at.get(k, 0.0) for k in draft.forces.inputs]
            found = compiled(draft.forces)(*given)[names.index(force)]
            peak = max(peak, float(np.max(np.abs(found))) / tire.load)
    share = _WIDE
    if "mu" in tire.spread:
        share = _MANY * tire.spread["mu"] / parameter_values(tire.model)["mu"]
    low, high = (float(f"{(1 + k * share) * peak:.6g}") for k in (-1, 1))
    peak = float(f"{peak:.6g}")
    return numpy_source(draft) + _SNIPPET.format(peak=peak, low=low, high=high)
