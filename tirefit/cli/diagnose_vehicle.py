"""``tirefit diagnose --vehicle``: find the effects that the model of a car lacks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from tirefit.cli.options import Text, option, progress_bar, start_jax
from tirefit.cli.output import check_results, claimed, told_where, write_result
from tirefit.display import Record

FILES = ("vehicle_diagnosis.json", "vehicle_diagnosis.png", "vehicle_diagnosis.html")
COMPARED = ("comparison.json", "comparison.png", "comparison.html")


TireOption = Annotated[
    Text, option("FIT.json|FILE.tir|MODEL", "--vehicle: tire of this axle (default: brush)")
]


def diagnose_car(
    logs: list[Path],
    vehicle: Path,
    tires: tuple[str | None, str | None],
    out: Path,
    sim_logs: list[Path],
    *,
    holdout: Sequence[Path],
    without: Sequence[str],
    figures: bool,
    full: bool,
    seed: int,
) -> None:
    """Diagnose the car, or compare it with its simulator; print the report, write the files.

    Args:
        tires: of the front and of the rear axle; None: brush.
        sim_logs: what the simulator predicted for each log; empty: diagnose the car itself.
    """
    names = COMPARED if sim_logs else FILES
    front, rear = (tire or "brush" for tire in tires)
    check_results([out / name for name in names], [*logs, *sim_logs])
    # The first line of progress at once, as JAX takes seconds to load and to compile.
    with claimed(out):
        with told_where(out, "diagnosis"), progress_bar("diagnose", soon=0.0) as progress:
            progress(0.01, "loading")
            start_jax()
            from tirefit.vehicle.diagnose import diagnose_vehicle
            from tirefit.vehicle.simulated import compare_with_simulator

            how: dict[str, Any] = {"without": without, "progress": progress}
            if sim_logs:
                result: Record = compare_with_simulator(logs, sim_logs, vehicle, front, rear, **how)
            else:
                how |= {"holdout": holdout, "seed": seed}
                result = diagnose_vehicle(logs, vehicle, front, rear, **how)
        drawn, page = ({names[1]: ""}, names[2]) if figures else ({}, "")
        text = result.summary() if sim_logs else result.summary(full=full)
        write_result(result, out, names, drawn, page, text=text)
