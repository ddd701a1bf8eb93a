"""The cases: which measured logs, what somebody changed in them, what must be named."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fits.measured_changes.logs import Change, Logs

CHOOSING, JUDGING = "choosing", "judging"
STRAIGHT = {"yaw_offset": 0.0096}
"""The heading zero of the dart car, taken out."""
ZERO = "slip_offset|speed_zero|slip_offset_speed|force_offset"
"""A zero of slip, force or speed that is the same in every run."""
RISING = "friction_speed.*|friction_sliding.*"
STEERING = "steering_(delay|lag|late).*"
DRIVE = "friction_ellipse|drive_force.*|combined_slip"
BY_RUN = "friction.*_run"
INERTIA = "yaw_inertia"
SIX = "slip zero -9.7 mrad; friction rises with the sliding speed"
ZEROED, DOUBLED = "slip zero -9.7 mrad", "yaw inertia doubled"
DRIVEN, LATE = "the drive force takes friction", "steering 90 to 150 ms late"
CONTROL = "control: nothing changed"


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        name: of the case and of its files.
        letter: of the list in README.md.
        use: "choosing" or "judging".
        logs: what is diagnosed.
        truth: what is known of it, in words.
        named: regular expressions; each must match the id of a named effect.
        never: what must match none.
        fitted_on: the brush fitted to these logs is the simulator; None for no
            simulator.
        change: parameter of the simulator -> True where it has changed, and the change
            must agree with SciPy's, False where it must not be said to differ.
        held_out: logs on which the named effects are judged at the end.
        in_time: leave out blocks of time though there are three runs or more.
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


def _dart(of: str = "circles free", change: Change | None = None, **how) -> Logs:
    return Logs(tuple(of.split()), change=change or Change(), **how)


def _car(of: str, axle: str = "rear", part: str = "all", **changed) -> Logs:
    return Logs((of,), axle, Change(**changed), part=part, every=10)


def _of_dart():
    """Cases of the dart car; ``vehicle.toml`` has its heading corrected in most."""
    right = Change(STRAIGHT)
    late = Change(STRAIGHT, {"vicon yaw": 0.01})
    halves = _dart(change=right, part="first"), _dart(change=right, part="second")
    free, circles = _dart("free", right), _dart("circles", right)
    yield Case("dart_six", "a", CHOOSING, _dart(), SIX,
               ("slip_offset", RISING), held_out=_dart("later"))  # fmt: skip
    yield Case(
        "dart_circles", "a", CHOOSING, _dart("circles"), ZEROED, ("slip_offset",)
    )
    yield Case("dart_heading_out", "e", CHOOSING, _dart(change=right),
               "that zero taken out", never=ZERO)  # fmt: skip
    yield Case("dart_heading_in", "e", CHOOSING,
               _dart(change=Change({"yaw_offset": 0.0196})),
               "slip zero +10 mrad put in", ("slip_offset",))  # fmt: skip
    yield Case("dart_yaw_late", "f", CHOOSING, _dart(change=late),
               "yaw read 10 ms late", (".*delay.*|tracked_point",))  # fmt: skip
    yield Case("dart_halves", "b", CHOOSING, halves[1], CONTROL, fitted_on=halves[0],
               change={"mu": False})  # fmt: skip
    yield Case("dart_floor", "d", CHOOSING, free, "another floor and day",
               fitted_on=circles, change={"mu": True})  # fmt: skip
    yield Case("dart_floors", "d", CHOOSING, _dart(change=right, runs="set"),
               "two floors as two runs", (BY_RUN,))  # fmt: skip
    yield Case("dart_later", "d", JUDGING, _dart("later", right),
               "27 September, floor not stated", fitted_on=_dart(change=right),
               change={"mu": True})  # fmt: skip


def _of_one_set(s: str):
    """Cases of one set of tires of the f1tenth car."""
    use = CHOOSING if s == "a" else JUDGING
    yield Case(f"{s}_drive", "j", use, _car(s), DRIVEN, (DRIVE,))
    yield Case(f"{s}_steering", "i", use, _car(s, "front"), LATE, (STEERING,))
    if s == "others":
        return
    yield Case(f"{s}_heading", "e", use, _car(s, vehicle={"sideslip_offset": 0.02}),
               "slip zero -20 mrad put in", ("slip_offset",))  # fmt: skip
    yield Case(f"{s}_force_late", "f", use, _car(s, late={"a_y": 0.08}),
               "lateral acceleration read 80 ms late", ("channel_delay",))  # fmt: skip
    yield Case(f"{s}_inertia", "h", use, _car(s, vehicle={"yaw_inertia": 0.24}),
               DOUBLED, (INERTIA,))  # fmt: skip
    first, second = _car(s, part="first"), _car(s, part="second")
    light = _car(s, part="second", scaled={"fz": 0.8})
    yield Case(f"{s}_load", "g", use, light, "load 20 % too low, on the second half",
               fitted_on=first, change={"mu": True, "cpa2": False})  # fmt: skip
    yield Case(f"{s}_halves", "b", use, second, CONTROL, fitted_on=first,
               change={"mu": False})  # fmt: skip


def _of_two_sets():
    """Cases of two sets of tires: the one fitted, the other diagnosed; or joined."""
    for one, other in ("ad", "da"):
        for axle in ("rear", "front"):
            yield Case(f"{one}_to_{other}_{axle}", "b", JUDGING, _car(other, axle),
                       f"tires {other.upper()}, simulated as {one.upper()}",
                       fitted_on=_car(one, axle), change={"mu": True})  # fmt: skip
    both = {"of": ("a", "d"), "every": 20}
    six = ("a_0", "a_2", "a_5", "d_0", "d_7", "d_24")
    truth = "tires A and D as two runs: friction and stiffness differ"
    yield Case("two_tires", "c", JUDGING, Logs(runs="set", **both), truth, (BY_RUN,))
    yield Case("two_tires_front", "c", JUDGING,
               Logs(axle="front", runs="set", **both), truth, (BY_RUN,))  # fmt: skip
    yield Case("two_tires_six_runs", "c", JUDGING, Logs(only=six, **both),
               "three runs of A, three of D", (BY_RUN,), in_time=True)  # fmt: skip


def _of_set_a():
    """Further cases of set A, for choosing."""
    yield Case("a_steering_later", "i", CHOOSING,
               _car("a", "front", late={"delta": 0.06}), "60 ms later still",
               (STEERING,))  # fmt: skip
    yield Case("a_halves_front", "b", CHOOSING, _car("a", "front", "second"), CONTROL,
               fitted_on=_car("a", "front", "first"), change={"mu": False})  # fmt: skip


_SETS = [case for s in ("a", "d", "others") for case in _of_one_set(s)]
CASES = (*_of_dart(), *_SETS, *_of_set_a(), *_of_two_sets())
