"""A rig's test with a known truth, as the fixtures of the readers lay it out."""

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
_IMPERIAL = {
    "v": MPH, "pressure": PSI, "fx": LBF, "fy": LBF, "fz": LBF, "mz": FOOT * LBF,
}  # fmt: skip
METRIC_UNITS = (
    "sec kph rpm deg deg cm cm kPa N N N N-m N-m none none".split() + ["deg C"] * 5
)
IMPERIAL_UNITS = (
    "sec mph rpm deg deg in in psi lb lb lb ft-lb ft-lb none none".split()
    + ["deg F"] * 5
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
