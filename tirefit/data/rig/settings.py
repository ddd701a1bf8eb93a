"""Settings of ``tirefit prepare``: ``[prepare]`` of the configuration."""

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat

from tirefit.settings import Section

Kind = Literal["sweep", "steady", "warm-up"]

KINDS = {
    "sweep": "slip or slip angle swept, all else held",
    "steady": "slip and all else held",
    "warm-up": "until the tire was warm",
    "standing": "the wheel does not roll",
    "transition": "changes between settings",
    "unusable": "rows that cannot be read",
}
"""Kind of segment -> its meaning."""


class PrepareConfig(Section):
    """How a rig test is segmented; times in seconds.

    ``bandwidth`` [Hz]: of the filter of all channels; chosen from the fastest sweeps if
    not given; ``filter = false`` does not filter. ``rate``: rows per second of a file
    without time. ``settle``: time cut from the ends of a hold next to a change.
    ``shortest``: shortest hold. ``warm_up``: time from the start in which the tire was
    not warm; found from its temperature if not given.
    ``keep``: kinds of segments that are written.
    """

    bandwidth: PositiveFloat | None = None
    filter: bool = True
    rate: PositiveFloat | None = None
    settle: NonNegativeFloat = 0.1
    shortest: PositiveFloat = 0.5
    warm_up: NonNegativeFloat | None = None
    keep: Annotated[list[Kind], Field(min_length=1)] = ["sweep", "steady"]
