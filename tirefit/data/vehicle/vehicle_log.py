"""Recognise the log of a vehicle by its headers: :func:`vehicle_log`."""

import json
import math
import re
from collections.abc import Mapping, Sequence

from tirefit.data.columns import stated_unit
from tirefit.data.units import known_unit
from tirefit.results import InputProblem

_ENDS = {
    "time": "time t timestamp stamp",
    "x": "x",
    "y": "y",
    "yaw": "yaw psi heading theta",
    "v_x": "vx speedx velx velocityx vlong vlon longvel linearx groundspeed corrspeed gpsspeed"
    " vehiclespeed velocity longitudinalspeed",
    "v_y": "vy speedy vely velocityy vlat latvel lineary lateralvel lateralvelocity lateralspeed",
    "yaw_rate": "r yawrate yawvelocity psidot gyroz angularz angularvelocityz",
    "a_y": "ay accy accely latacc lateralacc lateralacceleration gforcelat accellateral",
    "steering": "steering steer delta steeringangle steeredangle steerangle steeringwheel"
    " steeringwheelangle swa roadwheelangle",
}
"""Quantity of a log -> how headers of it end, without separators."""

_OF_ONE = ("yaw", "v_x", "v_y", "yaw_rate")
_CAR = (
    "mass = 1500         # kg",
    "l_f = 1.2           # m, front axle ahead of the centre of gravity",
    "l_r = 1.4           # m, rear axle behind it",
    "yaw_inertia = 2500  # kg m2",
    "# tracked_point = [0, 0]  # m, if the log describes another point than the centre of"
    " gravity: ahead of the rear axle, to the left",
    "[columns]",
)
IS_VEHICLE_LOG = "this is the log of a vehicle: it holds no slip and force of a tire"
_REACH = math.radians(10)  # rad, of a road wheel: about as far as a car steers at speed
_NO_PLACE = re.compile("^v$|acc|imu|mag|gyro|twist|linear|angular|vel|orientation|rotation")


def _message(header: str) -> str:
    """The topic of a channel of a bag: ``/odom`` of ``/odom.pose.position.x``."""
    return header.partition(".")[0] if header.startswith("/") else ""


def _template(headers: Mapping[str, str], names: Sequence[str], steered: str) -> str:
    """The lines of a vehicle.toml; those of needed channels without a column are comments.
    ``steered`` is the unit of the steering, as written."""
    lines = [*_CAR]
    for name in names:
        if name in headers:
            lines.append(f"{name} = {json.dumps(headers[name], ensure_ascii=False)}")
        elif name in ("v_x", "v_y", "yaw_rate"):
            other = _ENDS[name].split()[-1]
            lines.append(f'# {name} = "..."  # not in this log: a column such as {other!r}')
    if "steering" in headers:
        unit = known_unit(steered) if steered else None
        scale = unit.scale if unit and unit.dimension == "angle" else 1.0
        reach = 1.0 if scale == 1.0 else _REACH / scale
        angle = f"[{-reach * scale:.4g}, {reach * scale:.4g}]"
        lines += [
            "[steering]  # from the column to the road wheel angle [rad]",
            f"command = [{-reach:.4g}, {reach:.4g}]  # {steered or 'rad'}",
            f"angle = {angle}  # of a steering wheel: divide by the steering ratio",
        ]
    return "".join(f"\n      {line}" for line in lines)


def vehicle_log(
    headers: Sequence[str], file: str, by_pose: bool = True, units: Sequence[str] | None = None
) -> InputProblem | None:
    """The problem that a file is the log of a vehicle, with the command that computes
    forces from it, or with the channels that it lacks for that; None for another file. In a
    file with a slip, x, y and yaw may have other meanings: with ``by_pose=False`` only rates
    count. ``units`` are those of the columns, from a row below the headers.

    Example:
        >>> found = vehicle_log(["t", "vx", "vy", "yaw_rate [deg/s]"], "log.csv")
        >>> found.remedy.startswith("tirefit derive log.csv --vehicle vehicle.toml")
        True
    """
    from tirefit.data.vehicle.vehicle import POSE, RATES  # which no other reader waits for

    header_of: dict[str, str] = {}
    for header in headers:
        words = re.findall("[a-z0-9]+", re.sub(r"[\[(].*", "", header.casefold()))
        if words[-1:] == ["data"]:  # the field of a ROS message that holds one number
            words = words[:-1]
        ends = {"".join(words[-count:]) for count in (1, 2, 3)}
        for name, known in _ENDS.items():
            if name in ("x", "y") and _NO_PLACE.search("".join(words[:-1])):
                continue
            if name in ("v_x", "v_y") and "angular" in words:
                continue
            # Heading and speeds of the message that has the place, not of another sensor.
            message = _message(header_of.get("x", ""))
            beside = _message(header) == message != _message(header_of.get(name, ""))
            if ends & set(known.split()) and (name not in header_of or beside and name in _OF_ONE):
                header_of[name] = header
    # A message with both has measured both: speeds are differentiated once, not twice.
    messages = {_message(header_of.get(name, "")) for name in ("x", *RATES)}
    has_pose = by_pose and header_of.keys() >= {*POSE}
    motion = POSE if has_pose and (len(messages) > 1 or messages == {""}) else RATES
    steering = header_of.get("steering", "")
    below = units[list(headers).index(steering)] if units and steering else ""
    steered = " ".join((stated_unit(steering) or below).split())
    if not header_of.keys() >= {*motion}:
        there = [name for name in (*RATES, "a_y", "steering") if name in header_of]
        # No test rig measures two of these.
        if "time" not in header_of or len(there) < 2:
            return None
        has = ", ".join(f"{name} ({header_of[name]!r})" for name in there)
        lacks = " and ".join(name for name in RATES if name not in header_of)
        remedy = (
            "tirefit derive computes those of an axle from v_x, v_y and yaw_rate, or from the pose"
            f" x, y and yaw (VEHICLE.md). This log has {has}, and no {lacks}: add it, as from an"
            " optical sensor or a GPS with two antennas, or name its column in vehicle.toml:"
        )
        remedy += _template(header_of, ("time", *RATES, "a_y", "steering"), steered)
        remedy += f"\n      The columns of this log: {', '.join(map(repr, headers))}"
        return InputProblem(IS_VEHICLE_LOG, remedy, file)
    # The index of a data frame often has no header; in such logs it is the time.
    header_of.setdefault("time", "" if "" in headers else "HEADER")
    names = ("time", *motion, *(("a_y",) if motion == RATES else ()), "steering")
    return InputProblem(
        IS_VEHICLE_LOG,
        f"tirefit derive {file} --vehicle vehicle.toml --out axle.csv computes those of"
        " an axle. Write vehicle.toml (VEHICLE.md) with the numbers of your car:"
        + _template(header_of, names, steered),
        file,
    )
