"""``tirefit fit --vehicle``: fit the tires and unknown parameters of a car to its logs."""

from pathlib import Path
from typing import Any

from tirefit.cli.options import progress_bar, start_jax
from tirefit.cli.output import check_results, claimed, told_where, write_result
from tirefit.results import ExitCode, InputProblem, UsageError, exit_code

FIGURE = "trajectory.png"
FILES = ("trajectory.json", "front.json", "rear.json", "vehicle.toml", FIGURE)


def models_of(text: str | None) -> dict[str, Any]:
    """The models in ``front=brush,rear=brush``, or in a single name for both axles."""
    if text is None or "=" not in text:
        return dict.fromkeys(("front", "rear"), text or "brush")
    found = dict(part.strip().partition("=")[::2] for part in text.split(","))
    if set(found) != {"front", "rear"}:
        reason = f"--model {text} with --vehicle"
        raise UsageError(InputProblem(reason, "write front=brush,rear=brush"))
    return found


def fit_vehicle(
    logs: list[Path], vehicle: Path, model: str | None, out: Path | None, **how: Any
) -> ExitCode:
    """Fit the car, print the report and write the files.

    Args:
        how: keywords of :func:`~tirefit.vehicle.trajectory.fit_trajectory`; None for its defaults.
    """
    models, out = models_of(model), out or Path(f"{vehicle.stem}.fit")
    check_results([out / name for name in FILES], logs)
    how = {k: v for k, v in how.items() if v is not None}
    with claimed(out):
        with told_where(out, "fit"), progress_bar("fit", soon=0.0) as progress:
            progress(0.01, "loading")
            start_jax()
            from tirefit.vehicle.trajectory import fit_trajectory

            result = fit_trajectory(logs, vehicle, progress=progress, **(models | how))
        write_result(result, out, FILES, {FIGURE: ""})
    return exit_code(result.outcomes)
