"""Magic Formula 5.2 and 6.1 as one writes it in NumPy: F_x, F_y and M_z in combined slip.

The equations of Pacejka's book (3rd edition) at their numbers, over arrays, in the
axes of the file (ISO-W), with raw angles.
"""

import numpy as np


class Coefficients(dict):
    """Coefficients by their names in a .tir file, SI; absent ones are zero, absent scaling
    factors one."""

    def __missing__(self, name):
        return float(name.startswith("L") and name != "LMUV")


def shape_argument(x, e):
    return np.arctan(x - np.minimum(e, 1.0) * (x - np.arctan(x)))


def weight(slip, shift, b, c, e):
    """(4.E51) and (4.E59)."""
    return np.cos(c * shape_argument(b * (slip + shift), e)) / np.cos(
        c * shape_argument(b * shift, e)
    )


def magic_formula(c, kappa, alpha, gamma, fz, pressure, v=0.0, digression=1.0, version="6.1"):
    """F_x, F_y [N] and M_z [N m] in ISO-W axes; arrays (n,).

    ``c`` are :class:`Coefficients`, ``digression`` is A_mu of (4.E8).
    """
    dfz = fz / (c["LFZO"] * c["FNOMIN"]) - 1
    dpi = pressure / c["NOMPRES"] - 1
    fall = 1 + c["LMUV"] * v * np.hypot(kappa, np.tan(alpha)) / c["LONGVL"]
    grip = c["LMUX"] / fall, c["LMUY"] / fall
    lift = [digression * one / (1 + (digression - 1) * one) for one in grip]
    fx0, k_x = longitudinal(c, kappa, gamma, fz, dfz, dpi, grip[0], lift[0])
    of_side = fz, dfz, dpi, grip[1], lift[1], version
    side = upright = lateral(c, alpha, gamma, *of_side)
    if version != "5.2":
        upright = lateral(c, alpha, 0 * gamma, *of_side)
    b = (c["RBX1"] + c["RBX3"] * gamma**2) * np.cos(np.arctan(c["RBX2"] * kappa)) * c["LXAL"]
    e = c["REX1"] + c["REX2"] * dfz
    fx = fx0 * weight(alpha, c["RHX1"], b, c["RCX1"], e)
    b = (c["RBY1"] + c["RBY4"] * gamma**2) * c["LYKA"]
    b = b * np.cos(np.arctan(c["RBY2"] * (alpha - c["RBY3"])))
    e = c["REY1"] + c["REY2"] * dfz
    g_y = weight(kappa, c["RHY1"] + c["RHY2"] * dfz, b, c["RCY1"], e)
    induced = side["mu"] * fz * (c["RVY1"] + c["RVY2"] * dfz + c["RVY3"] * gamma)
    induced = induced * np.cos(np.arctan(c["RVY4"] * alpha)) * c["LVYKA"]
    induced = induced * np.sin(c["RVY5"] * np.arctan(c["RVY6"] * kappa))
    fy = g_y * side["fy"] + induced
    ratio = k_x / side["k"]
    trail = pneumatic_trail(c, alpha, gamma, fz, dfz, dpi, grip[1], ratio * kappa)
    moment = residual_moment(c, alpha, gamma, fz, dfz, dpi, grip[1], side, ratio * kappa)
    arm = c["SSZ1"] + c["SSZ2"] * fy / c["FNOMIN"]
    arm = c["UNLOADED_RADIUS"] * (arm + (c["SSZ3"] + c["SSZ4"] * dfz) * gamma) * c["LS"]
    return fx, fy, moment - trail * g_y * upright["fy"] + arm * fx


def longitudinal(c, kappa, gamma, fz, dfz, dpi, grip, lift):
    """F_x0 and K_xk, (4.E9) to (4.E18)."""
    mu = (c["PDX1"] + c["PDX2"] * dfz) * (1 - c["PDX3"] * (gamma * c["LGAX"]) ** 2)
    mu = mu * (1 + c["PPX3"] * dpi + c["PPX4"] * dpi**2) * grip
    k = fz * (c["PKX1"] + c["PKX2"] * dfz) * np.exp(c["PKX3"] * dfz) * c["LKX"]
    k = k * (1 + c["PPX1"] * dpi + c["PPX2"] * dpi**2)
    kappa = kappa + (c["PHX1"] + c["PHX2"] * dfz) * c["LHX"]
    e = (c["PEX1"] + c["PEX2"] * dfz + c["PEX3"] * dfz**2) * c["LEX"]
    e = e * (1 - c["PEX4"] * np.sign(kappa))
    shape = c["PCX1"] * c["LCX"]
    b = k / (shape * mu * fz)
    force = mu * fz * np.sin(shape * shape_argument(b * kappa, e))
    return force + fz * (c["PVX1"] + c["PVX2"] * dfz) * c["LVX"] * lift, k


def lateral(c, alpha, gamma, fz, dfz, dpi, grip, lift, version):
    """F_y0 and the values that M_z needs, (4.E19) to (4.E30)."""
    gamma, fz0 = gamma * c["LGAY"], c["LFZO"] * c["FNOMIN"]
    mu = (c["PDY1"] + c["PDY2"] * dfz) * (1 - c["PDY3"] * gamma**2) * grip
    mu = mu * (1 + c["PPY3"] * dpi + c["PPY4"] * dpi**2)
    peak = (c["PKY2"] + c["PKY5"] * gamma**2) * (1 + c["PPY2"] * dpi) * fz0
    k = c["PKY1"] * fz0 * (1 + c["PPY1"] * dpi) * (1 - c["PKY3"] * abs(gamma)) * c["LKY"]
    k = k * np.sin(c["PKY4"] * np.arctan(fz / peak))
    tilt = fz * (c["PVY3"] + c["PVY4"] * dfz) * gamma * c["LKYC"] * lift
    thrust = fz * (c["PKY6"] + c["PKY7"] * dfz) * (1 + c["PPY5"] * dpi) * gamma * c["LKYC"]
    s_h = (c["PHY1"] + c["PHY2"] * dfz) * c["LHY"]
    s_h = s_h + (c["PHY3"] * gamma if version == "5.2" else (thrust - tilt) / k)
    s_v = fz * (c["PVY1"] + c["PVY2"] * dfz) * c["LVY"] * lift + tilt
    alpha = alpha + s_h
    e = 1 + c["PEY5"] * gamma**2 - (c["PEY3"] + c["PEY4"] * gamma) * np.sign(alpha)
    e = (c["PEY1"] + c["PEY2"] * dfz) * e * c["LEY"]
    shape = c["PCY1"] * c["LCY"]
    b = k / (shape * mu * fz)
    fy = mu * fz * np.sin(shape * shape_argument(b * alpha, e)) + s_v
    return {"fy": fy, "k": k, "mu": mu, "slope": b * shape, "s_h": s_h, "s_v": s_v}


def equivalent(alpha, slip):
    """(4.E77) and (4.E78), without the sign."""
    return np.arctan(np.hypot(np.tan(alpha), slip))


def pneumatic_trail(c, alpha, gamma, fz, dfz, dpi, grip, slip):
    """t(alpha_t,eq), (4.E33), (4.E35) and (4.E40) to (4.E44)."""
    gamma = gamma * c["LGAZ"]
    at = alpha + c["QHZ1"] + c["QHZ2"] * dfz + (c["QHZ3"] + c["QHZ4"] * dfz) * gamma
    b = (c["QBZ1"] + c["QBZ2"] * dfz + c["QBZ3"] * dfz**2) * c["LKY"] / grip
    b = b * (1 + c["QBZ4"] * gamma + c["QBZ5"] * abs(gamma))
    d = fz * c["UNLOADED_RADIUS"] / c["FNOMIN"] * (c["QDZ1"] + c["QDZ2"] * dfz) * c["LTR"]
    d = d * (1 - c["PPZ1"] * dpi) * (1 + c["QDZ3"] * gamma + c["QDZ4"] * gamma**2)
    e = c["QEZ1"] + c["QEZ2"] * dfz + c["QEZ3"] * dfz**2
    bent = 2 / np.pi * np.arctan(b * c["QCZ1"] * at)
    e = e * (1 + (c["QEZ4"] + c["QEZ5"] * gamma) * bent)
    x = b * equivalent(at, slip)
    return d * np.cos(c["QCZ1"] * shape_argument(x, e)) * np.cos(alpha)


def residual_moment(c, alpha, gamma, fz, dfz, dpi, grip, side, slip):
    """M_zr, (4.E36) to (4.E38) and (4.E45) to (4.E47)."""
    gamma = gamma * c["LGAZ"]
    ar = alpha + side["s_h"] + side["s_v"] / side["k"]
    b = c["QBZ9"] * c["LKY"] / grip + c["QBZ10"] * side["slope"]
    tilt = (c["QDZ8"] + c["QDZ9"] * dfz) * (1 + c["PPZ2"] * dpi)
    tilt = (tilt + (c["QDZ10"] + c["QDZ11"] * dfz) * abs(gamma)) * gamma * c["LKZC"]
    d = fz * c["UNLOADED_RADIUS"] * ((c["QDZ6"] + c["QDZ7"] * dfz) * c["LRES"] + tilt) * grip
    return d * np.cos(np.arctan(b * equivalent(ar, slip))) * np.cos(alpha)
