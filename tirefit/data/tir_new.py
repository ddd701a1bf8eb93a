"""A new tire property file from coefficients: :func:`new_tir`."""

from collections.abc import Mapping, Sequence

from tirefit.data.tir import parse_tir
from tirefit.data.tir_file import TirFile, shortest
from tirefit.data.tir_keys import COEFFICIENTS, LIMITS, ONLY_IN

_FITTYP = {"5.2": 6, "6.1": 61, "6.2": 62}
_RANGES = {
    "kappa": "LONG_SLIP_RANGE", "alpha": "SLIP_ANGLE_RANGE",
    "gamma": "INCLINATION_ANGLE_RANGE", "fz": "VERTICAL_FORCE_RANGE",
    "pressure": "INFLATION_PRESSURE_RANGE",
}  # fmt: skip
_HEAD = """\
[MDI_HEADER]
FILE_TYPE                = 'tir'
FILE_VERSION             = 3.0
FILE_FORMAT              = 'ASCII'
{comment}[UNITS]
LENGTH                   = 'meter'
FORCE                    = 'newton'
ANGLE                    = 'radians'
MASS                     = 'kg'
TIME                     = 'second'
[MODEL]
PROPERTY_FILE_FORMAT     = 'MF{format}'
FITTYP                   = {fittyp}
TYRESIDE                 = 'UNKNOWN'
"""


def new_tir(
    version: str,
    values: Mapping[str, float],
    ranges: Mapping[str, tuple[float, float]],
    notes: Mapping[str, str],
    comment: Sequence[str] = (),
) -> TirFile:
    """A file of this version with these coefficients, in SI units.

    Args:
        version: 5.2, 6.1 or 6.2; keys of another one are left out.
        values: SI values by key, those that a tire needs among them.
        ranges: (least, largest) value by input of :data:`tir_keys.LIMITS`, in ISO-W.
        notes: comment behind the value of a key.
        comment: lines above the first section of values.

    Raises:
        DataError: values that make no tire.
    """
    above = "".join(f"$ {line}\n" for line in comment)
    kind = "-Tyre" if version == "5.2" else version.replace(".", "")
    text = _HEAD.format(comment=above, fittyp=_FITTYP[version], format=kind)
    lines = text.splitlines()
    section = "MODEL"
    of_version = [k for k in COEFFICIENTS if ONLY_IN.get(k, version[0]) == version[0]]
    # [MODEL] is open already.
    for key in sorted(of_version, key=lambda key: COEFFICIENTS[key] != "MODEL"):
        if key not in values:
            continue
        if COEFFICIENTS[key] != section:
            section = COEFFICIENTS[key]
            lines.append(f"[{section}]")
        said = f"          ${notes[key]}" if key in notes else ""
        lines.append(f"{key:<24} = {shortest(float(values[key]))}{said}")
    for name, (low, high) in ranges.items():
        lines.append(f"[{_RANGES[name]}]")
        for key, value in zip(LIMITS[name], (low, high), strict=True):
            lines.append(f"{key:<24} = {shortest(value)}")
    return parse_tir("\n".join(lines) + "\n", "fit.tir")
