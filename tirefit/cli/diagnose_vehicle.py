"""``tirefit diagnose --vehicle``: find the effects that the model of a car lacks."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.options import complain, progress_bar, start_jax
from tirefit.cli.output import check_results, claimed, write_result
from tirefit.results import InputProblem, UsageError

FILES = ("vehicle_diagnosis.json", "vehicle_diagnosis.png", "vehicle_diagnosis.html")
COMPARED = ("comparison.json", "comparison.png", "comparison.html")


TireOption = Annotated[
    str | None,
    typer.Option(
        metavar="FIT.json|FILE.tir|MODEL", help="--vehicle: tire of this axle (default: brush)"
    ),
]


def refuse_tires(front: str | None, rear: str | None, sim_log: object) -> None:
    """Raises UsageError if what belongs to a vehicle is given without one."""
    if front or rear or sim_log:
        reason = "--front, --rear or --sim-log without --vehicle"
        raise UsageError(InputProblem(reason, "name the vehicle.toml of the logs"))


def diagnose_car(
    logs: list[Path],
    vehicle: Path,
    front: str | None,
    rear: str | None,
    out: Path,
    *,
    holdout: Sequence[Path],
    without: Sequence[str],
    figures: bool,
    full: bool,
    seed: int,
) -> None:
    """Diagnose the car, print the report and write the files."""
    check_results([out / name for name in FILES], logs)
    # The first line of progress at once, as JAX takes seconds to load and to compile.
    with claimed(out):
        with _told_where(out), progress_bar("diagnose", soon=0.0) as progress:
            progress(0.01, "loading")
            start_jax()
            from tirefit.vehicle.diagnose import diagnose_vehicle

            result = diagnose_vehicle(
                logs, vehicle, front or "brush", rear or "brush",
                holdout=holdout, without=without, seed=seed, progress=progress,
            )  # fmt: skip
        drawn, page = ({FILES[1]: ""}, FILES[2]) if figures else ({}, "")
        write_result(result, out, FILES, drawn, page, full=full)


def compare_car(
    logs: list[Path],
    sim_logs: list[Path],
    vehicle: Path,
    tires: tuple[str | None, str | None],
    out: Path,
    without: Sequence[str],
    figures: bool,
) -> None:
    """Compare the car with its simulator, print what differs and write the files."""
    check_results([out / name for name in COMPARED], [*logs, *sim_logs])
    with claimed(out):
        with _told_where(out), progress_bar("diagnose", soon=0.0) as progress:
            progress(0.01, "loading")
            start_jax()
            from tirefit.vehicle.simulated import compare_with_simulator

            start = [tire or "brush" for tire in tires]
            result = compare_with_simulator(
                logs, sim_logs, vehicle, *start, without=without, progress=progress
            )
        drawn, page = ({COMPARED[1]: ""}, COMPARED[2]) if figures else ({}, "")
        write_result(result, out, COMPARED, drawn, page)


@contextmanager
def _told_where(out: Path) -> Iterator[None]:
    """Context manager: report, at an interrupt, the state of the folder of the results."""
    try:
        yield
    except KeyboardInterrupt:
        complain(f"{out}: the diagnosis was not complete, so its files are as before")
        raise
