"""Everything known of one file when its verdict stands."""

from dataclasses import dataclass

from tirefit.diagnosis.decide.verdict import Status, Verdict
from tirefit.diagnosis.effects import NOISE_EFFECTS
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.posterior import Weighed
from tirefit.diagnosis.evidence.search import Hypothesis, Search
from tirefit.diagnosis.left_out.predicted import Predicted
from tirefit.diagnosis.rows.rig import SlipCheck
from tirefit.diagnosis.summary.records import Untestable


@dataclass(frozen=True)
class Case:
    """Everything known of one file when its verdict stands; ``predicted`` is what the
    leading sets predict of data left out."""

    base: Base
    search: Search
    weighed: Weighed
    predicted: Predicted
    verdict: Verdict
    untestable: list[Untestable]

    @property
    def chosen(self) -> Hypothesis:
        """The fit of the named effects, or of none."""
        return self.weighed.best_of[self.verdict.key]

    @property
    def slip_check(self) -> SlipCheck | None:
        """The slip column against the slip of the wheel speed, where that is known."""
        return self.base.rows.slip_check

    @property
    def noise_flags(self) -> tuple[str, ...]:
        """What is odd about the noise of any channel."""
        levels = self.base.noise.values()
        return tuple(dict.fromkeys(flag for level in levels for flag in level.flags))

    @property
    def on_the_noise(self) -> tuple[str, ...]:
        """The effects on the noise alone, where none on the mean is possible."""
        if self.verdict.status != Status.NONE or self.verdict.also_possible:
            return ()
        of_flag = {effect.flag: effect.id for effect in NOISE_EFFECTS if effect.flag}
        return tuple(of_flag[f] for f in self.noise_flags if f in of_flag)
