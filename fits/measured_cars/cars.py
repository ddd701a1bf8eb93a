"""The cars: logs that are fitted, and logs that are left out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fits.replay.cars import write_logs

STEERING = ("steering_delay", "steering_offset")
OF_POSES = (*STEERING, "steering_ratio", "sideslip_zero")


@dataclass(frozen=True)
class Car:
    """One car on one set of tires or floor.

    Attributes:
        source: "a", "d", "others" (f1tenth car) or "dart", as in :mod:`fits.replay.cars`.
        fitted, left_out: numbers of its logs.
        unknowns: parameters of the car that are estimated with its tires.
        truth: what is known of it.
    """

    name: str
    source: str
    fitted: tuple[int, ...]
    left_out: tuple[int, ...]
    unknowns: tuple[str, ...] = STEERING
    truth: str = ""

    def logs(self, folder: Path) -> tuple[list[Path], list[Path], Path]:
        """The fitted logs, those left out, and ``vehicle.toml``, written into a folder."""
        paths, toml = write_logs(self.source, folder)
        return [paths[k] for k in self.fitted], [paths[k] for k in self.left_out], toml


CARS: Sequence[Car] = (
    Car("a", "a", (0, 2, 4), (1, 3), truth="tires A, 1:10"),
    Car("d", "d", (0, 2), (1, 3), truth="tires D, 1:10"),
    Car("others", "others", (0, 2, 4), (1, 3, 5), truth="several sets of tires, 1:10"),
    Car("circles", "dart", (0, 2), (1, 3), OF_POSES, "encoder car, circles, rubbery floor"),
    Car("free", "dart", (4,), (5,), OF_POSES, "encoder car, free driving, other floor"),
    Car("floors", "dart", (0, 2, 4), (1, 3, 5), OF_POSES, "encoder car, both floors"),
)
