"""The library of unmodelled effects: one record each.

An effect is a name and a change of :class:`effects.state.State`; one engine
fits, tests and ranks them all. A user's own effect is one more record::

    from tirefit.diagnosis.effects import EFFECTS, Effect

    def change(state, amplitude, constants, rows):
        ripple = np.sin(12 * rows.time)
        return state._replace(friction=state.friction * (1 + amplitude * ripple))

    mine = Effect(
        id="road_ripple", family="friction x time", change=change, scale=0.1, unit="-",
        formula="mu (1 + A sin 12 t)", needs=("time",),
        means="the road is rough in waves", remedy="measure on another road",
    )
    tirefit.diagnose(data, effects=EFFECTS + (mine,))
"""

from tirefit.diagnosis.effects import measurement, tire, vehicle
from tirefit.diagnosis.effects.record import (
    NOISE_EFFECTS,
    Atom,
    Effect,
    NoiseEffect,
    Prior,
    atoms_of,
    effects_by_id,
    library,
)

__all__ = [
    "EFFECTS",
    "NOISE_EFFECTS",
    "Atom",
    "Effect",
    "NoiseEffect",
    "Prior",
    "atoms_of",
    "effects_by_id",
]

EFFECTS: tuple[Effect, ...] = library(
    "tirefit.diagnosis.effects", measurement.CODE | tire.CODE | vehicle.CODE
)
