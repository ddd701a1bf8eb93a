"""The cases: measured logs, the known change in them, and the effects to be named."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fits.measured_changes.logs import Logs

CHOOSING, JUDGING = "choosing", "judging"
STRAIGHT = {"yaw_offset": 0.0096}
"""The heading offset of the dart car, corrected."""
ZERO = "slip_offset|speed_zero|slip_offset_speed|force_offset"
"""A zero offset of slip, force or speed that is the same in every run."""
RISING = "friction_speed.*|friction_sliding.*"
STEERING = "steering_(delay|lag|late).*"
DRIVE = "friction_ellipse|drive_force.*|combined_slip"
BY_RUN = "friction.*_run"
INERTIA = "yaw_inertia"
ZEROED, DOUBLED = "slip offset -9.7 mrad", "yaw inertia doubled"
SIX = f"{ZEROED}; friction rises with the sliding speed"
DRIVEN, LATE = "the drive force uses friction", "steering 90 to 150 ms late"
CONTROL, SAME = "control: nothing changed", {"mu": False, "cpa2": False}


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        name: name of the case and of its files.
        letter: kind of change.
        use: "choosing" or "judging".
        logs: the diagnosed logs.
        truth: the known change, in words.
        named: regular expressions; each must match the id of a named effect.
        never: regular expression that no named effect may match.
        fitted_on: the brush fitted to these logs is the simulator; None for no
            simulator.
        change: parameter of the simulator -> True if it has changed, and the change
            must agree with SciPy's; False if it must not be reported to differ.
        held_out: logs on which the named effects are judged at the end.
        in_time: leave out blocks of time even for three or more runs.
    """

    name: str
    letter: str
    use: str
    logs: Logs
    truth: str
    named: tuple[str, ...] = ()
    never: str = ""
    fitted_on: Logs | None = None
    change: Mapping[str, bool] = field(default_factory=dict)
    held_out: Logs | None = None
    in_time: bool = False


def _dart(of: str = "circles free", **how) -> Logs:
    return Logs(tuple(of.split()), **how)


def _car(of: str, axle: str = "rear", part: str = "all", **changed) -> Logs:
    return Logs((of,), axle, part=part, every=10, **changed)


def _of_dart():
    """Cases of the dart car; most correct its heading in ``vehicle.toml``."""
    right = {"vehicle": STRAIGHT}
    even, odd = _dart(**right, part="even"), _dart(**right, part="odd")
    free, circles = _dart("free", **right), _dart("circles", **right)
    yield Case(
        "dart_six", "a", CHOOSING, _dart(), SIX, ("slip_offset", RISING), held_out=_dart("later")
    )
    yield Case("dart_circles", "a", CHOOSING, _dart("circles"), ZEROED, ("slip_offset",))
    yield Case(
        "dart_heading_out",
        "e",
        CHOOSING,
        _dart(**right),
        "heading offset corrected; rising friction",
        (RISING,),
        ZERO,
    )
    yield Case(
        "dart_heading_in",
        "e",
        CHOOSING,
        _dart(vehicle={"yaw_offset": 0.0196}),
        "slip offset of +10 mrad added",
        ("slip_offset",),
    )
    yield Case(
        "dart_yaw_late",
        "f",
        CHOOSING,
        _dart(**right, late={"vicon yaw": 0.01}),
        "yaw delayed by 10 ms",
        (".*delay.*|tracked_point",),
    )
    yield Case("dart_halves", "b", CHOOSING, odd, CONTROL, fitted_on=even, change=SAME)
    yield Case(
        "dart_floor",
        "d",
        CHOOSING,
        free,
        "another floor and day",
        fitted_on=circles,
        change={"mu": True},
    )
    yield Case(
        "dart_floors",
        "d",
        CHOOSING,
        _dart(**right, runs="set"),
        "two floors as two runs; rising friction",
        (RISING,),
        ZERO,
    )
    yield Case(
        "dart_later",
        "d",
        JUDGING,
        _dart("later", **right),
        "27 September: by hand the same friction",
        fitted_on=_dart(**right),
        change={"mu": False},
    )


def _of_one_set(s: str):
    """Cases of one set of tires of the f1tenth car."""
    use = CHOOSING if s == "a" else JUDGING
    yield Case(f"{s}_drive", "j", use, _car(s), DRIVEN, (DRIVE,))
    yield Case(f"{s}_steering", "i", use, _car(s, "front"), LATE, (STEERING,))
    if s == "others":
        return
    yield Case(
        f"{s}_heading",
        "e",
        use,
        _car(s, vehicle={"sideslip_offset": 0.02}),
        "slip offset of -20 mrad added",
        ("slip_offset",),
    )
    yield Case(
        f"{s}_force_late",
        "f",
        use,
        _car(s, late={"fy": 0.06}),
        "lateral force delayed by 60 ms",
        ("channel_delay",),
    )
    yield Case(
        f"{s}_inertia", "h", use, _car(s, vehicle={"yaw_inertia": 0.24}), DOUBLED, (INERTIA,)
    )
    even, odd = _car(s, part="even"), _car(s, part="odd")
    light = _car(s, part="odd", scaled={"fz": 0.8})
    yield Case(
        f"{s}_load",
        "g",
        use,
        light,
        "load 20 % too low, on the odd tenths",
        fitted_on=even,
        change={"mu": True, "cpa2": False},
    )
    yield Case(f"{s}_halves", "b", use, odd, CONTROL, fitted_on=even, change=SAME)


def _of_both():
    """Two sets of tires, one fitted and the other diagnosed, or joined; further cases of A."""
    for one, other in ("ad", "da"):
        for axle in ("rear", "front"):
            yield Case(
                f"{one}_to_{other}_{axle}",
                "b",
                JUDGING,
                _car(other, axle),
                f"tires {other.upper()}, simulated as {one.upper()}",
                fitted_on=_car(one, axle),
                change={"mu": True},
            )
    both = {"of": ("a", "d"), "every": 20}
    six = ("a_0", "a_2", "a_5", "d_0", "d_7", "d_24")
    truth = "tires A and D as two runs: friction and stiffness differ"
    yield Case("two_tires", "c", JUDGING, Logs(runs="set", **both), truth, (BY_RUN,))
    yield Case(
        "two_tires_front", "c", JUDGING, Logs(axle="front", runs="set", **both), truth, (BY_RUN,)
    )
    yield Case(
        "two_tires_six_runs",
        "c",
        JUDGING,
        Logs(only=six, **both),
        "three runs of A, three of D",
        (BY_RUN,),
        in_time=True,
    )
    yield Case(
        "a_steering_out",
        "i",
        CHOOSING,
        _car("a", "front", late={"delta": 0.097}),
        "delay of 97 ms removed",
        never=f"{STEERING}|channel_delay|relaxation_length",
    )
    yield Case(
        "a_halves_front",
        "b",
        CHOOSING,
        _car("a", "front", "odd"),
        CONTROL,
        fitted_on=_car("a", "front", "even"),
        change=SAME,
    )


_SETS = [case for s in ("a", "d", "others") for case in _of_one_set(s)]
CASES = (*_of_dart(), *_SETS, *_of_both())
