"""What ``tirefit prepare`` can be told: ``[prepare]`` of the configuration."""

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat

from tirefit.settings import Section

Kind = Literal["sweep", "steady", "cold", "warm-up", "spring-rate", "load-step"]

KINDS = {
    "sweep": "slip or slip angle swept, all else held",
    "steady": "slip and all else held",
    "cold": "sweep before the tire was warm",
    "warm-up": "until the tire was warm",
    "spring-rate": "load moved slowly, slip held",
    "load-step": "load on its way from one setting to another",
    "standing": "the wheel does not roll",
    "transition": "anything else on its way",
    "unusable": "rows that cannot be read",
}
"""Kind of segment -> what it is."""


class PrepareConfig(Section):
    """How a rig's test is cut up; times in seconds.

    ``bandwidth`` [Hz] is that of the one filter of all channels, chosen from the
    fastest sweeps if not given; ``filter = false`` leaves the samples alone. ``rate``:
    rows a second of a file without time. ``settle`` is cut from either end of what is
    held beside a change. Nothing shorter than ``shortest`` counts as held. ``warm_up``:
    how long from the start the tire was not warm; told by its temperature, or by sweeps
    that repeat themselves, if not given. Unless it is given or ``cut_last`` is
    set, the last sweeps of a condition without later ones are kept. ``keep``: kinds
    of segments that are written.
    """

    bandwidth: PositiveFloat | None = None
    filter: bool = True
    rate: PositiveFloat | None = None
    settle: NonNegativeFloat = 0.1
    shortest: PositiveFloat = 0.5
    warm_up: NonNegativeFloat | None = None
    cut_last: bool = False
    keep: Annotated[list[Kind], Field(min_length=1)] = ["sweep", "steady"]
