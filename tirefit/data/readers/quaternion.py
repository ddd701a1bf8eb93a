"""Compute headings from the quaternions of a table: :func:`with_headings`."""

import re
from dataclasses import replace

import numpy as np

from tirefit.data.check import read_numbers
from tirefit.data.columns import guess
from tirefit.data.readers.text import Table

_PART = re.compile(
    r"(?P<stem>(?:(?:.*[\W_])?(?:q|quat|quaternion|ori|rot|attitude)"
    r"|.*orientation|.*rotation)[\W_]*)(?P<part>[xyzw])\W*(?:[\[({].*)?",
    re.IGNORECASE,
)
"""``qx``, ``field.pose.pose.orientation.x``, ``/tf/rotation/w``, ``quat_z [-]``."""


def with_headings(table: Table) -> tuple[Table, dict[str, str]]:
    """The table with a column ``...yaw`` [rad] for each quaternion, and a map from the
    headers that name a quaternion (its components, their common beginning) to it.

    Rows without a component, or with a norm that is not 1, are NaN and are counted in
    the notes. If no header means a heading, the column of a single quaternion does.
    """
    places_of: dict[str, dict[str, int]] = {}
    for place, header in enumerate(table.headers):
        if match := _PART.fullmatch(header.strip()):
            parts = places_of.setdefault(match["stem"], {})
            parts[match["part"].lower()] = place
    whole = {stem: parts for stem, parts in places_of.items() if len(parts) == 4}
    known = any((g := guess(header)) and g.name == "heading" for header in table.headers)
    named: dict[str, str] = {}
    for stem, parts in whole.items():
        name = re.sub(r"(^|[\W_])q$", r"\1", stem, flags=re.IGNORECASE) + "yaw"
        if name in table.headers:
            continue
        numbers = {
            part: read_numbers(table.cells[place], part, table.ragged, True)[0]
            for part, place in parts.items()
        }
        x, y, z, w = (numbers[part] for part in "xyzw")
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        missing = np.isnan(norm) & ~table.ragged
        # Components may be rounded to one decimal place.
        odd = np.abs(norm - 1) > 0.1
        note = f"from the quaternion {', '.join(table.headers[parts[k]] for k in 'xyzw')}"
        note += f"; {missing.sum()} rows lack it" if missing.any() else ""
        if odd.any():
            note += f"; {odd.sum()} rows masked, whose norm is not 1"
        yaw = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
        values, layout = np.where(odd, np.nan, yaw), table.layout
        if len(whole) == 1 and not known:
            layout = layout._replace(names={**layout.names, name: "heading"})
        table = replace(
            table,
            headers=[*table.headers, name],
            cells=[*table.cells, values],
            units_row=table.units_row and [*table.units_row, "rad"],
            notes=(*table.notes, f"column {name!r} computed {note}"),
            layout=layout,
        )
        components = [table.headers[place] for place in parts.values()]
        named |= dict.fromkeys([*components, stem, stem.rstrip("_./- ["), name], name)
    return table, named
