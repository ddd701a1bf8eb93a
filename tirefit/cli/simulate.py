"""``tirefit simulate``: logs of braking and sweeps of a rig, with a known truth."""

from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.options import (
    SetOption,
    errors_to_exit,
    named_path,
    numbers,
    say,
    start_jax,
)
from tirefit.results import InputProblem, UsageError

app = typer.Typer(
    help="Simulate logs and rig sweeps that fit and estimate read.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Out = Annotated[
    Path, typer.Option(metavar="FILE.csv", parser=named_path, help="CSV file to write")
]
Truth = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.csv", parser=named_path, help="CSV of the truth, without noise"
    ),
]
Drop = Annotated[
    str | None,
    typer.Option(metavar="TIME=FRICTION", help="friction that holds from this time"),
]
Seed = Annotated[int, typer.Option(min=0, max=2**32 - 1, help="of the noise")]


@app.command()
def braking(
    out: Out,
    truth: Truth = None,
    amplitude: Annotated[
        float, typer.Option(help="largest torque, as share of the tire's peak")
    ] = 0.75,
    teeth: Annotated[int, typer.Option(min=1, help="saw-teeth of the torque")] = 5,
    period: Annotated[float, typer.Option(min=0.1, help="of a saw-tooth [s]")] = 2.0,
    rate: Annotated[float, typer.Option(min=1.0, help="rows a second")] = 100.0,
    speed: Annotated[float, typer.Option(min=1.0, help="of the vehicle [m/s]")] = 20.0,
    load: Annotated[float, typer.Option(min=1.0, help="of the wheel [N]")] = 27e3,
    friction: Annotated[float, typer.Option(min=0.05, help="peak force / load")] = 0.98,
    tire: Annotated[str, typer.Option(help="magic-formula or lugre")] = "magic-formula",
    drop: Drop = None,
    slip_variance: Annotated[
        float, typer.Option(min=0.0, help="of the noise on the slip")
    ] = 0.2e-4,
    force_variance: Annotated[
        float, typer.Option(min=0.0, help="of the noise on the force, over load^2")
    ] = 0.2e-2,
    seed: Seed = 0,
) -> None:
    """A wheel braked in saw-teeth, S section 5.1: a log in time order."""
    with errors_to_exit():
        change = _drop(drop)
        limits = [
            ("--amplitude", amplitude, 0.0, 2.0), ("--period", period, 0.0, 1e4),
            ("--speed", speed, 0.0, 1e3), ("--load", load, 0.0, 1e9),
            ("--friction", friction, 0.0, 5.0),
            ("--slip-variance", slip_variance, -1e-9, 1.0),
            ("--force-variance", force_variance, -1e-9, 1.0),
            *_of_log(rate, teeth * period, change),
        ]  # fmt: skip
        _check(out, truth, limits)
        if tire not in ("magic-formula", "lugre"):
            raise UsageError(f"--tire {tire!r} is not known", "magic-formula or lugre")
        start_jax()
        from tirefit.sim.braking import Braking, simulate_braking

        how = Braking(
            amplitude=amplitude, teeth=teeth, period=period, rate=rate, v=speed,
            fz=load, friction=friction, tire=tire, drop=change, seed=seed,
            slip_variance=slip_variance, force_variance=force_variance,
        )  # fmt: skip
        _write(simulate_braking(how), out, truth, seed)


@app.command()
def drive(
    out: Out,
    truth: Truth = None,
    duration: Annotated[float, typer.Option(help="of the drive [s]")] = 30.0,
    rate: Annotated[float, typer.Option(min=1.0, help="rows a second")] = 50.0,
    speed: Annotated[float, typer.Option(help="that is kept [m/s]")] = 25.0,
    bend: Annotated[
        float, typer.Option(help="largest lateral acceleration of the road, over mu g")
    ] = 0.6,
    bend_period: Annotated[float, typer.Option(help="of the bends [s]")] = 5.0,
    brake: Annotated[
        float, typer.Option(help="largest deceleration asked for, over mu g")
    ] = 0.0,
    brake_period: Annotated[float, typer.Option(help="of a braking [s]")] = 4.0,
    friction: Annotated[float, typer.Option(min=0.05, help="of the road")] = 0.9,
    drop: Drop = None,
    gps_std: Annotated[
        float, typer.Option(min=0.0, help="noise of positions [m]")
    ] = 0.02,
    gyro_std: Annotated[
        float, typer.Option(min=0.0, help="noise of yaw and roll rate [rad/s]")
    ] = 0.002,
    seed: Seed = 0,
) -> None:
    """A car on a winding road, braked now and then: a log of its sensors."""
    with errors_to_exit():
        change = _drop(drop)
        limits = [
            ("--duration", duration, 0.1, 1e4), ("--speed", speed, 1.0, 100.0),
            ("--bend", bend, -1e-9, 1.0), ("--bend-period", bend_period, 0.5, 1e3),
            ("--brake", brake, -1e-9, 2.0), ("--brake-period", brake_period, 0.5, 1e3),
            ("--friction", friction, 0.0, 5.0), ("--gps-std", gps_std, -1e-9, 1e3),
            ("--gyro-std", gyro_std, -1e-9, 10.0), *_of_log(rate, duration, change),
        ]  # fmt: skip
        _check(out, truth, limits)
        start_jax()
        from tirefit.sim.drive import Drive, simulate_drive

        how = Drive(
            duration=duration, rate=rate, v=speed, bend=bend, bend_period=bend_period,
            brake=brake, brake_period=brake_period, friction=friction, drop=change,
            gps_std=gps_std, gyro_std=gyro_std, seed=seed,
        )  # fmt: skip
        _write(simulate_drive(how), out, truth, seed)


@app.command()
def rig(
    out: Out,
    truth: Truth = None,
    model: Annotated[str, typer.Option(help="model of `tirefit models`")] = "brush",
    parameter: SetOption = None,
    load: Annotated[
        list[float] | None, typer.Option(help="[N], may be repeated")
    ] = None,
    speed: Annotated[
        list[float] | None, typer.Option(help="[m/s], may be repeated")
    ] = None,
    largest: Annotated[float, typer.Option(help="last slip, or angle [rad]")] = 0.2,
    points: Annotated[int, typer.Option(min=2, help="rows of a sweep")] = 100,
    lateral: Annotated[bool, typer.Option("--lateral", help="sweep alpha")] = False,
    slip_std: Annotated[float, typer.Option(min=0.0, help="noise of the slip")] = 0.0,
    force_std: Annotated[
        float, typer.Option(min=0.0, help="noise of the force, over the load")
    ] = 0.01,
    seed: Seed = 0,
) -> None:
    """Sweeps of slip on a test rig, of any model: one after the other."""
    with errors_to_exit():
        problems: list[InputProblem] = []
        values = numbers("--set", parameter, problems)
        UsageError.raise_for(problems)
        loads, speeds = load or [4000.0], speed or [20.0]
        limits = [("--load", x, 0.0, 1e9) for x in loads]
        limits += [("--speed", x, 0.0, 1e3) for x in speeds]
        limits += [
            ("--largest", largest, 0.0, 1.5), ("--slip-std", slip_std, -1e-9, 1.0),
            ("--force-std", force_std, -1e-9, 1.0),
            (_ROWS, points * len(loads) * len(speeds), 1.0, _MOST_ROWS),
        ]  # fmt: skip
        _check(out, truth, limits)
        start_jax()
        from tirefit.fitting.problem import find_model
        from tirefit.params import check_values
        from tirefit.sim.rig import simulate_rig

        check_values(find_model(model), model, values)
        made = simulate_rig(
            model, values, loads=loads, speeds=speeds, largest=largest, points=points,
            lateral=lateral, slip_std=slip_std, force_std=force_std, seed=seed,
        )  # fmt: skip
        _write(made, out, truth, seed)


def _drop(text: str | None) -> tuple[float, float] | None:
    """Time and friction of ``TIME=FRICTION``."""
    if text is None:
        return None
    try:
        time, friction = map(float, text.split("="))
    except ValueError:
        reason = f"--drop {text!r} is not TIME=FRICTION"
        raise UsageError(reason, "as in --drop 5=0.4") from None
    if not (time > 0 and 0.05 <= friction <= 5):
        reason = f"--drop {text!r} is out of range"
        raise UsageError(reason, "a time > 0 s, a friction 0.05 to 5")
    return time, friction


_ROWS, _MOST_ROWS = "number of rows", 1e7  # what all of them need some GB of memory for


def _of_log(rate: float, duration: float, drop) -> list[tuple]:
    """Limits of a log: of its rows, and of the time at which friction changes."""
    dropped = [("--drop at", drop[0], 0.0, duration)] if drop else []
    return [(_ROWS, rate * duration, 1.0, _MOST_ROWS), *dropped]


def _check(out: Path, truth: Path | None, limits) -> None:
    """Raises UsageError with all that is wrong with files and numbers."""
    from tirefit.data.write import output_problems

    problems = []
    for path in filter(None, (out, truth)):
        problems += output_problems(path, ending=".csv")
    if truth is not None and truth.absolute() == out.absolute():
        problems.append(InputProblem("--truth is --out", "give it another name"))
    for option, value, low, high in limits:
        if not low < value <= high:
            reason = f"{option} {value:g} is out of range"
            least = "from 0" if low < 0 else f"above {low:g}, up"
            problems.append(InputProblem(reason, f"{least} to {high:g}"))
    UsageError.raise_for(problems)


def _write(made, out: Path, truth: Path | None, seed: int) -> None:
    from tirefit.data.write import csv_text
    from tirefit.files import write_texts

    texts = {out: csv_text(made.columns)}
    if truth is not None:
        texts[truth] = csv_text(made.truth)
    write_texts(texts)
    rows = len(made.columns["time"])
    columns = ", ".join(made.columns)
    say(f"wrote {out}: {rows} rows, {columns} (braking positive, SI), seed {seed}")
    if truth is not None:
        say(f"wrote {truth}: the same without noise, {', '.join(made.truth)}")
