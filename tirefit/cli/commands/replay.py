"""``tirefit replay``: predict measured logs from measured states."""

from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli import options as cli
from tirefit.cli.output import check_results, write_result
from tirefit.data.readers.remote import file_at
from tirefit.files import write_texts
from tirefit.results import InputProblem, UsageError

_TIRE = "FIT.json|FILE.tir|MODEL"
_MCAP = "also write measured and predicted motion for Foxglove, PlotJuggler"
_EFFECTS = "also predict with the effects that tirefit diagnose --vehicle named"
FIGURES, PAGE = {"replay.png": "path", "series.png": "series"}, "replay.html"
FILES = ("replay.json", *FIGURES, PAGE)


def replay(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG", parser=file_at, help="vehicle logs")],
    *,
    vehicle: Annotated[Path, cli.option("VEHICLE.toml", "vehicle.toml of the car and its log")],
    front: Annotated[str, cli.option(_TIRE, "tire of the front axle")],
    rear: Annotated[str, cli.option(_TIRE, "tire of the rear axle")],
    out: cli.Folder,
    horizon: Annotated[
        list[float] | None,
        cli.option("S", "prediction time [s] (repeat for more; default: 0.25, 0.5, 1, 2, 5)"),
    ] = None,
    effects: Annotated[cli.File, cli.option("VEHICLE_DIAGNOSIS.json", _EFFECTS)] = None,
    mcap: Annotated[cli.File, cli.path_option("FILE.mcap", _MCAP)] = None,
    seed: cli.Seed = 0,
    html: cli.Html = False,
) -> None:
    """Predict measured drives of a car from its tires; report the error over time.

    The car starts every quarter of a second from the measured state and is predicted
    for up to five seconds, with the speed and the steering as measured. The same car on
    linear tires, and a car without slip, are predicted for comparison.
    """
    if mcap and mcap.suffix.lower() != ".mcap":
        raise UsageError(InputProblem("the output is MCAP", "end it in .mcap", str(mcap)))
    check_results([*(out / name for name in FILES), *([mcap] if mcap else [])])
    cli.start_jax()
    from tirefit.vehicle.mcap import writers
    from tirefit.vehicle.replay import HORIZONS
    from tirefit.vehicle.replay import replay as predicted

    if mcap:
        writers()  # fails before the work if the library is missing
    with cli.progress_bar("replay", soon=0.0) as progress:
        result = predicted(
            logs,
            vehicle,
            front,
            rear,
            horizons=horizon or HORIZONS,
            effects=effects,
            seed=seed,
            progress=progress,
        )
    write_result(result, out, FILES, FIGURES, PAGE if html else "")
    if mcap:
        mcap.parent.mkdir(parents=True, exist_ok=True)
        write_texts({mcap: result.to_mcap()})
        cli.say(f"wrote {mcap}")
