"""Effects, covariates and needs of a diagnosis in words, and what to do about them."""

from collections.abc import Sequence

import numpy as np

from tirefit.data.table import CANONICAL
from tirefit.diagnosis.effects import EFFECTS, NOISE_EFFECTS, Effect, effects_by_id
from tirefit.diagnosis.rows.rig import SlipCheck
from tirefit.diagnosis.summary.closure import WORST
from tirefit.diagnosis.summary.result import Amplitude, Diagnosis, Estimate
from tirefit.diagnosis.summary.views import Region, Shape
from tirefit.report.numbers import format_estimate, format_number
from tirefit.slip import CONVENTIONS

_NEEDS = {
    "loads": "more than one load",
    "speeds": "more than one speed",
    "signs": "slips of both signs",
    "sweeps": "slow sweeps of slip with time",
    "v": "speed v",
    "omega": "wheel speed omega",
    "rolling_radius": "rolling_radius in rig.toml, or v with omega",
    "temperature": "a temperature that varies",
    "gamma": "a camber gamma that varies",
    "other slip": "the other slip, not zero",
    "finite slips": "slips of a wheel that rolls: none of 90 degrees",
    "other force": "the force of the other slip",
    "pressure": "an inflation pressure that varies",
    "work": "speed v with time: the work of sliding",
    "a_x": "acceleration a_x",
    "a_y": "acceleration a_y",
    "heading": "a heading that turns",
    "steering": "a road wheel angle of this axle that varies",
    "derived force": "a force derived from a_y and yaw_acceleration (tirefit derive)",
    "doubted point": "a stated tracked point that tirefit derive does not confirm",
    "runs": "several runs (a column run)",
    "mz": "the aligning moment mz",
}
_BY_DERIVE = {
    "other force": "driven",
    "steering": "[steering], of the front axle",
    "loads": "h_cg",
    "heading": "x, y, yaw in [columns]",
    "a_x": "[columns]",
    "a_y": "[columns]",
}
"""Need -> key of vehicle.toml with which a derived file meets it."""

_COVARIATES = {
    "slip_fraction": ("slip / slip of full sliding", ""),
    "fz": ("load F_z", "N"),
    "v": ("speed v", "m/s"),
    "time": ("time", "s"),
    "direction": ("size of the slip", ""),
    "sign": ("sign of the slip", ""),
    "temperature": ("temperature", CANONICAL["temperature"][0]),
    "gamma": ("camber gamma", CANONICAL["gamma"][0]),
    "used_friction": ("share of friction used", ""),
    "slip": ("signed slip / slip of full sliding", ""),
    "signed_slip": ("signed slip", ""),
    "slip_rate": ("rate of the slip", "1/s"),
    "distance": ("distance travelled", "m"),
    "pressure": ("inflation pressure", CANONICAL["pressure"][0]),
    "yaw rate": ("yaw rate", "rad/s"),
    "front slip": ("front slip", "rad"),
    "rear slip": ("rear slip", "rad"),
    "forward acceleration": ("forward acceleration", "g"),
}
"""Covariate -> words, and unit."""

NAMED_VALUES = {
    "direction": {-1.0: "shrinking", 0.0: "steady", 1.0: "growing"},
    "sign": {-1.0: "negative", 0.0: "zero", 1.0: "positive"},
}


def words_on(effect: str, library: Sequence[Effect] = (), derived: bool = False) -> tuple[str, str]:
    """Meaning and remedy of an effect; empty for an unknown one.

    Args:
        effect: its id.
        library: effects that were searched, including a user's own.
        derived: whether ``tirefit derive`` wrote the rows.
    """
    record = effects_by_id((*EFFECTS, *NOISE_EFFECTS, *library)).get(effect)
    if record is None:
        return "", ""
    return record.means, (derived and record.remedy_derived) or record.remedy


def needs_text(needs: Sequence[str], derived: bool = False) -> str:
    """``needs`` of an untestable effect as text.

    Args:
        derived: whether ``tirefit derive`` could write what is missing.
    """
    keys = [_BY_DERIVE[need] for need in needs if derived and need in _BY_DERIVE]
    how = f" (tirefit derive writes it: {', '.join(keys)} of vehicle.toml)" if keys else ""
    return ", ".join(_NEEDS.get(need, need) for need in needs) + how


def covariate_text(name: str) -> str:
    """A covariate of ``where`` in words."""
    return _COVARIATES.get(name, (name, ""))[0]


def range_text(region: Region) -> str:
    """The place of a region: a value or a range, with its unit."""
    name, low, high = region.covariate, region.low, region.high
    if name in NAMED_VALUES:
        # The few steady rows among growing or shrinking ones do not determine the name.
        return NAMED_VALUES[name][round(high if abs(high) > abs(low) else low)]
    unit = covariate_unit(name)
    tail = f" {unit}" if unit else ""
    # With hardly any friction on some rows, their slip is far beyond full sliding.
    reach = 100.0 if name in ("slip_fraction", "slip") else np.inf
    largest = max(abs(low), abs(high))
    least = 5e-4 * (largest if largest <= reach else 1.0)
    clipped = np.clip((low, high), -reach, reach).tolist()
    ends = [format_number(0.0 if abs(end) < least else end, 3) for end in clipped]
    if high > reach:
        return "any" if low < -reach else f"{ends[0]} and more"
    if low < -reach:
        return f"{ends[1]} and less"
    return f"{format_number(low)}{tail}" if low == high else f"{' to '.join(ends)}{tail}"


def covariate_unit(name: str) -> str:
    """Unit of a covariate of figures; empty if it has none."""
    return _COVARIATES.get(name, ("", CANONICAL.get(name, ("", ""))[0]))[1].removeprefix("-")


def shape_text(shape: Shape) -> str:
    """What a remainder resembles: ``friction changes with time, by -7 % at 60 s``."""
    covariate = covariate_text(shape.covariate)
    at = f"{format_number(shape.at, 3)} {covariate_unit(shape.covariate)}".rstrip()
    at = NAMED_VALUES.get(shape.covariate, {}).get(round(shape.at), at)
    size = f"{format_number(100 * shape.size, 2)} %{' of F_z' * (shape.parameter == 'force')}"
    if shape.parameter == "slip":
        size = format_number(shape.size, 2)
    return f"{shape.parameter} changes with {covariate}, by {size} at {at}"


_OF_CAR = {"all": "the motion", "v_y": "lateral speed", "yaw_rate": "yaw rate"}


def channel_name(channel: str) -> str:
    """``F_x``, ``F_y`` or ``M_z``; a channel of a car in words."""
    if channel in ("fx", "fy", "mz"):
        return f"{channel[0].upper()}_{channel[1:]}"
    return _OF_CAR.get(channel, channel)


def name_of(effect: str) -> str:
    """Readable name of an effect: ``slip offset`` of ``slip_offset``."""
    return effect.replace("_", " ")


def listing(words: Sequence[str], last: str = "and") -> str:
    """``a, b and c``."""
    *others, end = words
    return f"{', '.join(others)} {last} {end}" if others else end


def set_name(effects: Sequence[str]) -> str:
    """Readable name of a set of effects, the empty set and the unlisted included."""
    names = ["an unlisted effect" if e == "unknown" else name_of(e) for e in effects]
    return " + ".join(names) or "no effect"


def size_of(result: Diagnosis, effect: str) -> Amplitude | None:
    """The amplitude of an effect that helps; None for another one."""
    sizes = result.amplitudes.items()
    return next((size for name, size in sizes if name.startswith(f"{effect}: ")), None)


def sized_name(effect: str, size: Amplitude | Estimate | None) -> str:
    """``slip offset of 0.27 ± 0.03 m``; the name alone without a size."""
    name = name_of(effect)
    return f"{name} of {amount_text(size.value, size.std, size.unit)}" if size else name


def amplitude_text(amplitude: Amplitude) -> str:
    """``value ± std unit``, with its formula if the effect has several."""
    text = amount_text(amplitude.value, amplitude.std, amplitude.unit)
    return f"{text}, {amplitude.formula}" if amplitude.formula else text


def in_the_file(result: Diagnosis, amplitude: Amplitude) -> str:
    """The amplitude of a slip or force in the signs of the file, if these differ."""
    if not result.data.convention:
        return ""  # of a car
    channel, signs = result.data.channels[0], CONVENTIONS[result.data.convention]
    kinds = {"of slip": "slip" if channel == "fx" else "alpha", "F_z": channel}
    kind = next((kind for of, kind in kinds.items() if of in amplitude.unit), "")
    if getattr(signs, kind, 1) > 0:
        return ""
    text = amount_text(-amplitude.value, None, amplitude.unit)
    return f" ({text} in the file's signs, {result.data.convention})"


def readable_unit(unit: str) -> tuple[float, str]:
    """A factor on amplitudes in the unit of an effect, and their readable unit: ``% of
    the mean F_z`` of ``1e-3 mean F_z``, ``per record`` of
    ``- per record``, ``/ g`` of ``1 / g``; empty of none."""
    if unit.startswith("1e-3 "):
        return 0.1, f"% of {unit.removeprefix('1e-3 ').replace('mean', 'the mean')}"
    if unit == "-" or unit.startswith(("- ", "1 / ")):
        return 1.0, unit[1:].strip()
    return 1.0, unit


def amount_text(value: float, std: float | None, unit: str) -> str:
    """An amplitude with its unit: ``0.27 ± 0.03 % of the mean F_z``.

    Args:
        std: its standard error, None where it has none.
        unit: of an effect.
    """
    factor, tail = readable_unit(unit)
    text = format_estimate(factor * value, None if std is None else factor * std)
    return f"{text} {tail}".rstrip()


def share_text(share: float) -> str:
    """``95 %``."""
    return f"{100 * share:.0f} %"


def closed_text(closed: float, ends: tuple[float | None, float | None]) -> str:
    """The closed share of a gap with its interval; ``-100 % or worse`` if the effects double the
    gap or more."""
    message, *more = (
        share_text(share) + " or worse" * (share <= WORST)
        for share in (closed, *ends)
        if share is not None
    )
    return f"{message} [{', '.join(more)}]" if more else message


def p_text(p: float) -> str:
    """A p-value with two digits, or an upper limit of a very small one."""
    return f"{p:.2g}" if p > 1e-12 else "< 1e-12"


def slip_check_line(check: SlipCheck) -> str:
    """A line on the comparison of the slip column with the slip of the wheel speed."""
    other = f", follows {check.fits}" if check.fits != check.read_as else ""
    return (
        f"slip, read as {check.read_as}, against omega, v and a rolling radius of"
        f" {format_number(check.radius)} m: {format_number(check.rms, 2)} rms apart,"
        f" offset {format_estimate(check.offset, check.offset_std)}{other}"
    )
