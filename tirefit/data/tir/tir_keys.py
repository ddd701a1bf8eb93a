"""The keys of a ``.tir`` file: section, unit, version, and which are required."""

FITTYP: dict[float, str] = dict.fromkeys((5, 6, 21, 51, 52), "5.2")
FITTYP |= {60: "6.1", 61: "6.1", 62: "6.2"}
"""Value of FITTYP -> version of the Magic Formula whose equations are used."""

SIDES = ("LEFT", "RIGHT", "SYMMETRIC", "UNKNOWN")

COEFFICIENTS = {
    "VERTICAL": "FNOMIN",
    "DIMENSION": "UNLOADED_RADIUS",
    "MODEL": "LONGVL",
    "OPERATING_CONDITIONS": "NOMPRES INFLPRES",
    "SCALING_COEFFICIENTS": "LFZO LMUV LCX LMUX LEX LKX LHX LVX LGAX LXAL LCY LMUY LEY"
    " LKY LHY LVY LGAY LKYC LYKA LVYKA LTR LRES LGAZ LKZC LS LMX LVMX LMY",
    "LONGITUDINAL_COEFFICIENTS": "PCX1 PDX1 PDX2 PDX3 PEX1 PEX2 PEX3 PEX4 PKX1 PKX2"
    " PKX3 PHX1 PHX2 PVX1 PVX2 PPX1 PPX2 PPX3 PPX4 RBX1 RBX2 RBX3 RCX1 REX1 REX2 RHX1",
    "LATERAL_COEFFICIENTS": "PCY1 PDY1 PDY2 PDY3 PEY1 PEY2 PEY3 PEY4 PEY5 PKY1 PKY2"
    " PKY3 PKY4 PKY5 PKY6 PKY7 PHY1 PHY2 PHY3 PVY1 PVY2 PVY3 PVY4 PPY1 PPY2 PPY3 PPY4"
    " PPY5 RBY1 RBY2 RBY3 RBY4 RCY1 REY1 REY2 RHY1 RHY2 RVY1 RVY2 RVY3 RVY4 RVY5 RVY6",
    "ALIGNING_COEFFICIENTS": "QBZ1 QBZ2 QBZ3 QBZ4 QBZ5 QBZ9 QBZ10 QCZ1 QDZ1 QDZ2 QDZ3"
    " QDZ4 QDZ6 QDZ7 QDZ8 QDZ9 QDZ10 QDZ11 QEZ1 QEZ2 QEZ3 QEZ4 QEZ5 QHZ1 QHZ2 QHZ3 QHZ4"
    " PPZ1 PPZ2 SSZ1 SSZ2 SSZ3 SSZ4",
    "OVERTURNING_COEFFICIENTS": "QSX1 QSX2 QSX3 QSX4 QSX5 QSX6 QSX7 QSX8 QSX9 QSX10"
    " QSX11 QSX12 QSX13 QSX14 PPMX1",
    "ROLLING_COEFFICIENTS": "QSY1 QSY2 QSY3 QSY4 QSY5 QSY6 QSY7 QSY8",
}
COEFFICIENTS = {key: section for section, keys in COEFFICIENTS.items() for key in keys.split()}
"""Key that the steady-state forces and moments use -> section it stands in."""

SECTIONS = COEFFICIENTS | {
    **dict.fromkeys("FITTYP TYRESIDE USE_MODE FE_METHOD".split(), "MODEL"),
    "WIDTH": "DIMENSION",
    **dict.fromkeys(("VERTICAL_STIFFNESS", "VERTICAL_DAMPING"), "VERTICAL"),
    **dict.fromkeys(("MASS", "IXX", "IYY"), "INERTIA"),
}
"""Key that can be added to a file -> section it goes to."""

ONLY_IN = {
    **dict.fromkeys("PHY3 LGAX LGAY LGAZ".split(), "5"),
    **dict.fromkeys(
        "PEY5 PKY4 PKY5 PKY6 PKY7 PPX1 PPX2 PPX3 PPX4 PPY1 PPY2 PPY3 PPY4 PPY5 PPZ1"
        " PPZ2 RBX3 RBY4 QDZ10 QDZ11 LKYC LKZC LMUV QSX4 QSX5 QSX6 QSX7 QSX8 QSX9"
        " QSX10 QSX11 QSX12 QSX13 QSX14 PPMX1 QSY5 QSY6 QSY7 QSY8".split(),
        "6",
    ),
}
"""Coefficient -> the one generation of the Magic Formula that has it."""

NEUTRAL = {"PKY4": 2.0, "LMUV": 0.0, "QSY7": 1.0}
"""Values without effect, except 0 of coefficients and 1 of factors L..."""

PRESSURE_TERMS = [key for key in COEFFICIENTS if key.startswith("PP")] + ["QSY8"]

REQUIRED = {
    "F_x": {
        "PCX1": "the shape factor",
        "PDX1": "the longitudinal friction",
        "PKX1": "the slip stiffness over load",
    },
    "F_y": {
        "PCY1": "the shape factor",
        "PDY1": "the lateral friction",
        "PKY1": "the cornering stiffness over load (negative)",
        "PKY2": "the load of the largest cornering stiffness",
    },
    "M_z": {
        "UNLOADED_RADIUS": "the free radius",
        "QBZ1": "the slope of the trail",
        "QCZ1": "the shape factor of the trail",
        "QDZ1": "the trail over the free radius (0: no moment by it)",
    },
}
"""Force -> key that its formula needs -> meaning of the key."""

POSITIVE = ("UNLOADED_RADIUS", "FNOMIN", "LONGVL", "NOMPRES", "INFLPRES", "LFZO")
NONZERO = ("PCX1", "PDX1", "PCY1", "PDY1", "PKY2")

LIMITS = {
    "kappa": ("KPUMIN", "KPUMAX"),
    "alpha": ("ALPMIN", "ALPMAX"),
    "gamma": ("CAMMIN", "CAMMAX"),
    "fz": ("FZMIN", "FZMAX"),
    "pressure": ("PRESMIN", "PRESMAX"),
}
"""Input in ISO-W axes -> keys of the range in which the coefficients were found."""

DIMENSIONS = {
    **dict.fromkeys("UNLOADED_RADIUS WIDTH RIM_RADIUS RIM_WIDTH".split(), "length"),
    **dict.fromkeys("FNOMIN FZMIN FZMAX".split(), "force"),
    **dict.fromkeys("LONGVL VXLOW".split(), "speed"),
    **dict.fromkeys("ALPMIN ALPMAX CAMMIN CAMMAX".split(), "angle"),
    **dict.fromkeys("NOMPRES INFLPRES PRESMIN PRESMAX".split(), "pressure"),
}
"""Key -> dimension; the rest is dimensionless, in radians, or not used here."""

ALIASES = {"LFZ0": "LFZO", "IP_NOM": "NOMPRES", "IP": "INFLPRES"}
"""Alias of a key (the last two are of PAC2002) -> its name here."""

NUMERIC = {*COEFFICIENTS, *DIMENSIONS, *sum(LIMITS.values(), ()), "USE_MODE"}
"""Keys whose values must be numbers."""

UNITS = {
    "LENGTH": "length",
    "FORCE": "force",
    "ANGLE": "angle",
    "TIME": "time",
    "PRESSURE": "pressure",
}
"""Key of [UNITS] that is used -> dimension, whose units :mod:`tirefit.data.units` lists."""

KNOWN = {*NUMERIC, *SECTIONS, *UNITS, "PROPERTY_FILE_FORMAT", "FILE_TYPE", "FE_METHOD"}
"""Keys that are read."""
