"""Everything known of one file when its verdict stands."""

from dataclasses import dataclass

from tirefit.diagnosis.base import Base
from tirefit.diagnosis.records import Untestable
from tirefit.diagnosis.search import Search
from tirefit.diagnosis.slip_check import SlipCheck
from tirefit.diagnosis.verdict import Verdict, Weighed

__all__ = ["Case"]


@dataclass(frozen=True)
class Case:
    """Everything known of one file when its verdict stands."""

    base: Base
    search: Search
    weighed: Weighed
    verdict: Verdict
    untestable: list[Untestable]

    @property
    def slip_check(self) -> SlipCheck | None:
        """The slip column against the slip of the wheel speed, where that is known."""
        return self.base.rows.slip_check
