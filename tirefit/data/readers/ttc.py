"""Files of the FSAE Tire Test Consortium (Calspan), recognised by their layout.

Columns ``ET V N SA IA RL RE P FX FY FZ MX MZ ...``, text or MATLAB, in metric or in
imperial units, in the signs of SAE J670: z down, so that F_z is negative.
"""

from dataclasses import replace

import numpy as np

from tirefit.data.check import read_numbers
from tirefit.data.readers.text import Table
from tirefit.data.table import Layout

_MARKS = {"ET", "IA", "RL", "RE", "TSTC", "AMBTMP", "NFX", "NFY"}
_SLIPS = {"SA", "SL", "SR"}

_METRIC = {
    "ET": "s", "V": "km/h", "N": "rpm", "SA": "deg", "IA": "deg", "P": "kPa",
    "FX": "N", "FY": "N", "FZ": "N", "MX": "N m", "MZ": "N m",
    "TSTC": "degC", "SL": "-", "SR": "-",
}  # fmt: skip
_IMPERIAL = _METRIC | {
    "V": "mph",
    "P": "psi",
    "FX": "lbf",
    "FY": "lbf",
    "FZ": "lbf",
    "MX": "ft-lb",
    "MZ": "ft-lb",
    "TSTC": "degF",
}


def recognised(table: Table) -> Table:
    """The table with signs, meanings and, unless stated, units by its layout.

    A table of another layout is returned unchanged. Signs are those of SAE if F_z is
    negative, else those of ISO.
    """
    names = set(table.headers)
    if not ("FZ" in names and names & _SLIPS and names & _MARKS):
        return table
    layout = table.layout
    load = _median(table, "FZ")
    convention, reason = "iso-w", "FZ is positive, so the file was converted: signs read as 'iso-w'"
    if layout.convention:
        convention, reason = layout.convention, f"signs stated in line {layout.stated_in}"
    elif load is None or load < 0:
        convention, reason = "sae", "signs read as 'sae', as FZ is negative"
    notes = [f"laid out as Tire Test Consortium files are: {reason}"]
    meant = {"N": "omega"} | ({"SL": "kappa"} if "SL" in names else {})
    if {"SL", "SR"} <= names:
        meant |= {"SR": ""}
        notes.append("slip from 'SL', which is 0 where FX is 0; 'SR' uses another radius")
    units, units_from = table.units_row, table.layout.units_from
    if units is None:
        pressure = _median(table, "P")
        # Pressures below this number are in psi, above in kPa; racing tires have 8 to 14 psi.
        is_imperial = pressure is not None and pressure < 35.0
        by = _IMPERIAL if is_imperial else _METRIC
        units = [by.get(header, "") for header in table.headers]
        units_from = "as in Tire Test Consortium files"
        if pressure is not None:
            system = "psi: imperial" if is_imperial else "kPa: metric"
            notes.append(f"no units stated: P of {pressure:.4g} is {system} units")
    layout = Layout(meant, units_from, convention, layout.stated_in)
    return replace(table, layout=layout, units_row=units, notes=(*table.notes, *notes))


def _median(table: Table, header: str) -> float | None:
    """The median of a column; None without such a column or numbers in it."""
    if header not in table.headers:
        return None
    cells = table.cells[table.headers.index(header)]
    values = read_numbers(cells, header, table.ragged)[0]
    return float(np.nanmedian(values)) if np.isfinite(values).any() else None
