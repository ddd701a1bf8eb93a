"""A rig test with a known truth, in the formats of the fixtures of the readers."""

import numpy as np

DEG = np.pi / 180
LBF, PSI, MPH, FOOT = 4.4482216152605, 6894.757293168361, 0.44704, 0.3048


def truth(n=120, seed=3):
    """Canonical SI columns of a sweep of slip angle at two loads and cambers, (n,)."""
    rng = np.random.default_rng(seed)
    row = np.arange(n)
    alpha = np.round(12 * np.sin(2 * np.pi * row / 40), 3) * DEG
    load = np.where(row < n // 2, 700.0, 1500.0)
    gamma = np.where(row // 20 % 2, 3.0, 0.0) * DEG
    shape = np.sin(1.4 * np.arctan(9 * alpha)) + 0.6 * gamma
    fy = np.round(1.5 * load * shape + rng.normal(0, 3, n), 2)
    trail = 0.03 * np.exp(-((alpha / 0.1) ** 2))
    return {
        "time": np.round(0.01 * row, 2),
        "v": np.full(n, 40.0) / 3.6,
        "omega": np.full(n, 420.0) * 2 * np.pi / 60,
        "alpha": alpha,
        "gamma": gamma,
        "pressure": np.full(n, 83e3),
        "fx": np.round(rng.normal(0, 2, n), 2),
        "fy": fy,
        "fz": load + np.round(rng.normal(0, 5, n), 2),
        "mz": np.round(-trail * fy, 3),
        "temperature": np.round(40 + 0.1 * row, 1),
    }


TTC_COLUMNS = {
    "ET": "time", "V": "v", "N": "omega", "SA": "alpha", "IA": "gamma", "RL": None,
    "RE": None, "P": "pressure", "FX": "fx", "FY": "fy", "FZ": "fz", "MX": None,
    "MZ": "mz", "NFX": None, "NFY": None, "RST": None, "TSTI": None,
    "TSTC": "temperature", "TSTO": None, "AMBTMP": None,
}  # fmt: skip
"""Headers of a cornering test of the Tire Test Consortium, in their order."""

_SAE = {"alpha": -1, "fx": -1, "fz": -1}
_METRIC = {"v": 1 / 3.6, "pressure": 1e3, "fx": 1, "fy": 1, "fz": 1, "mz": 1}
_IMPERIAL = {"v": MPH, "pressure": PSI, "fx": LBF, "fy": LBF, "fz": LBF, "mz": FOOT * LBF}
METRIC_UNITS = "sec kph rpm deg deg cm cm kPa N N N N-m N-m none none".split() + ["deg C"] * 5
IMPERIAL_UNITS = (
    "sec mph rpm deg deg in in psi lb lb lb ft-lb ft-lb none none".split() + ["deg F"] * 5
)


def ttc(columns, imperial=False):
    """Canonical columns as the file has them: SAE signs, header -> (n,) values."""
    scale = {"omega": 2 * np.pi / 60, "alpha": DEG, "gamma": DEG, "time": 1.0}
    scale |= _IMPERIAL if imperial else _METRIC
    frame = {}
    for header, name in TTC_COLUMNS.items():
        if name is None:
            frame[header] = np.full(len(columns["time"]), 1.0)
        elif name == "temperature":
            frame[header] = columns[name] * (1.8 if imperial else 1) + 32 * imperial
        else:
            frame[header] = _SAE.get(name, 1) * columns[name] / scale[name]
    return frame


TYDEX_CHANNELS = [  # name, comment, unit, column, factor, offset, physical offset
    ("MEASNUMB", "Measurement point No.", "-", None, 1, 0, 0),
    ("RUNTIME", "Running time", "s", "time", 0.001, 0, 0),
    ("LONGVEL", "Longitudinal velocity", "km/h", "v", 1, 0, 0),
    ("WHROTSPD", "Wheel rotation speed", "1/min", "omega", 1, 0, 0),
    ("SLIPANGL", "Slip angle", "deg", "alpha", 0.5, 0, 1),
    ("FX", "Longitudinal force", "N", "fx", 1, 0, 0),
    ("FYW", "Lateral force", "kN", "fy", 0.001, 4, 0),
    ("FZW", "Vertical force", "N", "fz", 1, 0, 0),
    ("MZW", "Aligning torque", "Nm", "mz", 1, 0, 0),
    ("TYRETEMP", "Temperature of the tread", "deg C", "temperature", 1, 0, 0),
]
_ISO = {"fx": -1, "fy": -1, "mz": -1}
_TYDEX_UNITS = {"v": 1 / 3.6, "omega": 2 * np.pi / 60, "alpha": DEG, "fy": 1e3}


def tydex(columns, per_line=8, missing=()):
    """Lines of a TYDEX 1.3 file; camber and pressure are constants. The values of
    ``missing``, as (row, channel), are unavailable.

    ``missing`` are (row, channel) whose value is not available.
    """
    rule = "!---------!-----------------------------!---------!---------!---------!"
    lines = [
        "!# Id: a demonstration", "**HEADER", rule,
        f"{'RELEASE':<10}{'Release of TYDEX-Format':<40}{'1.3':<10}",
        f"{'SUPPLIER':<10}{'Data supplier':<40}{'DEMO':<10}", "",
        "**COMMENTS", rule, "! Key     ! Comment", "! New tyre used", "",
        "**CONSTANTS", rule,
        f"{'MANUFACT':<10}{'Manufacturer of the tyre':<40}{'NOTAVAIL':<10}",
        f"{'NOMWIDTH':<10}{'Nominal section width':<30}{'mm':<10}{'225':<10}",
        f"{'INFLPRES':<10}{'Inflation pressure':<30}{'bar':<10}{'0.83':<10}",
        f"{'INCLANGL':<10}{'Inclination angle':<30}{'deg':<10}{'3.0':<10}",
        f"{'FZW':<10}{'Nominal vertical force':<30}{'N':<10}{'700':<10}", "",
        "**MEASURCHANNELS", rule,
    ]  # fmt: skip
    raw = []
    for name, comment, unit, column, factor, before, after in TYDEX_CHANNELS:
        given = "".join(f"{number:<10g}" for number in (factor, before, after))
        lines.append(f"{name:<10}{comment:<30}{unit:<10}{given}".rstrip())
        if column is None:
            raw.append(np.arange(len(columns["time"]), dtype=float))
            continue
        value = _ISO.get(column, 1) * columns[column] / _TYDEX_UNITS.get(column, 1)
        raw.append((value - after) / factor - before)
    lines += ["", "**MEASURDATA"]
    names = [channel[0] for channel in TYDEX_CHANNELS]
    for row, values in enumerate(zip(*raw, strict=True)):
        texts = [
            "NOTAVAIL" if (row, name) in missing else f"{value:.6g}"
            for name, value in zip(names, values, strict=True)
        ]
        for at in range(0, len(texts), per_line):
            lines.append("".join(f"{text:<10}" for text in texts[at : at + per_line]))
    return [*lines, "", "**END"]
