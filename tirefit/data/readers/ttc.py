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
    negative; those of a file converted to z up follow from its slip angle and force.
    """
    names = set(table.headers)
    if not ("FZ" in names and names & _SLIPS and names & _MARKS):
        return table
    layout = table.layout
    load = _median(table, "FZ")
    slip, force = _numbers(table, "SA"), _numbers(table, "FY")
    usable = np.isfinite(slip + force) if len(slip) and len(force) else []
    turned = "FZ is positive, so the file was converted: signs read as"
    convention, reason = "iso-w", f"{turned} 'iso-w'"
    if layout.convention:
        convention, reason = layout.convention, f"signs stated in line {layout.stated_in}"
    elif load is None or load < 0:
        convention, reason = "sae", "signs read as 'sae', as FZ is negative"
    elif np.any(usable) and np.sum(slip[usable] * force[usable]) > 0:
        convention, reason = "adapted-sae", f"{turned} 'adapted-sae', by SA and FY"
    notes = [f"laid out as Tire Test Consortium files are: {reason}"]
    meant = {"N": "omega"}
    if {"SL", "SR"} <= names:
        meant |= {"SL": "kappa", "SR": ""}
        notes.append("slip from 'SL', which is 0 where FX is 0; 'SR' uses another radius")
    elif "SL" in names:
        meant |= {"SL": "kappa"}
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


def _numbers(table: Table, header: str) -> np.ndarray:
    """A column (n,), NaN for cells without a number; (0,) without such a column."""
    if header not in table.headers:
        return np.empty(0)
    cells = table.cells[table.headers.index(header)]
    return read_numbers(cells, header, table.ragged)[0]


def _median(table: Table, header: str) -> float | None:
    values = _numbers(table, header)
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else None
