"""Magic Formula 6.1 as one writes it in NumPy: F_x, F_y and M_z in combined slip.

The equations of Pacejka's book (3rd edition) at their numbers, over arrays, in the
axes of the file (ISO-W), with raw angles and slip-speed friction left out.
"""

import numpy as np


def shape_argument(x, e):
    return np.arctan(x - np.minimum(e, 1.0) * (x - np.arctan(x)))


def weight(slip, shift, b, c, e):
    """(4.E51) and (4.E59)."""
    return np.cos(c * shape_argument(b * (slip + shift), e)) / np.cos(
        c * shape_argument(b * shift, e)
    )


def magic_formula_61(c, kappa, alpha, gamma, fz, pressure):
    """F_x, F_y [N] and M_z [N m] in ISO-W axes; arrays (n,).

    ``c`` gives a coefficient by its name in a .tir file, SI, absent ones as zero,
    scaling factors 1.
    """
    dfz = fz / c["FNOMIN"] - 1
    dpi = pressure / c["NOMPRES"] - 1
    fx0, k_x = longitudinal(c, kappa, gamma, fz, dfz, dpi)
    side = lateral(c, alpha, gamma, fz, dfz, dpi)
    upright = lateral(c, alpha, 0 * gamma, fz, dfz, dpi)
    b = (c["RBX1"] + c["RBX3"] * gamma**2) * np.cos(np.arctan(c["RBX2"] * kappa))
    e = c["REX1"] + c["REX2"] * dfz
    fx = fx0 * weight(alpha, c["RHX1"], b, c["RCX1"], e)
    b = c["RBY1"] + c["RBY4"] * gamma**2
    b = b * np.cos(np.arctan(c["RBY2"] * (alpha - c["RBY3"])))
    e = c["REY1"] + c["REY2"] * dfz
    g_y = weight(kappa, c["RHY1"] + c["RHY2"] * dfz, b, c["RCY1"], e)
    induced = side["mu"] * fz * (c["RVY1"] + c["RVY2"] * dfz + c["RVY3"] * gamma)
    induced = induced * np.cos(np.arctan(c["RVY4"] * alpha))
    induced = induced * np.sin(c["RVY5"] * np.arctan(c["RVY6"] * kappa))
    fy = g_y * side["fy"] + induced
    ratio = k_x / side["k"]
    trail = pneumatic_trail(c, alpha, gamma, fz, dfz, dpi, ratio * kappa)
    moment = residual_moment(c, alpha, gamma, fz, dfz, dpi, side, ratio * kappa)
    arm = c["SSZ1"] + c["SSZ2"] * fy / c["FNOMIN"]
    arm = c["UNLOADED_RADIUS"] * (arm + (c["SSZ3"] + c["SSZ4"] * dfz) * gamma)
    return fx, fy, moment - trail * g_y * upright["fy"] + arm * fx


def longitudinal(c, kappa, gamma, fz, dfz, dpi):
    """F_x0 and K_xk, (4.E9) to (4.E18)."""
    mu = (c["PDX1"] + c["PDX2"] * dfz) * (1 - c["PDX3"] * gamma**2)
    mu = mu * (1 + c["PPX3"] * dpi + c["PPX4"] * dpi**2)
    k = fz * (c["PKX1"] + c["PKX2"] * dfz) * np.exp(c["PKX3"] * dfz)
    k = k * (1 + c["PPX1"] * dpi + c["PPX2"] * dpi**2)
    kappa = kappa + c["PHX1"] + c["PHX2"] * dfz
    e = c["PEX1"] + c["PEX2"] * dfz + c["PEX3"] * dfz**2
    e = e * (1 - c["PEX4"] * np.sign(kappa))
    b = k / (c["PCX1"] * mu * fz)
    force = mu * fz * np.sin(c["PCX1"] * shape_argument(b * kappa, e))
    return force + fz * (c["PVX1"] + c["PVX2"] * dfz), k


def lateral(c, alpha, gamma, fz, dfz, dpi):
    """F_y0 and the values that M_z needs, (4.E19) to (4.E30)."""
    mu = (c["PDY1"] + c["PDY2"] * dfz) * (1 - c["PDY3"] * gamma**2)
    mu = mu * (1 + c["PPY3"] * dpi + c["PPY4"] * dpi**2)
    peak = (c["PKY2"] + c["PKY5"] * gamma**2) * (1 + c["PPY2"] * dpi) * c["FNOMIN"]
    k = c["PKY1"] * c["FNOMIN"] * (1 + c["PPY1"] * dpi) * (1 - c["PKY3"] * abs(gamma))
    k = k * np.sin(c["PKY4"] * np.arctan(fz / peak))
    tilt = fz * (c["PVY3"] + c["PVY4"] * dfz) * gamma
    thrust = fz * (c["PKY6"] + c["PKY7"] * dfz) * (1 + c["PPY5"] * dpi) * gamma
    s_h = c["PHY1"] + c["PHY2"] * dfz + (thrust - tilt) / k
    s_v = fz * (c["PVY1"] + c["PVY2"] * dfz) + tilt
    alpha = alpha + s_h
    e = 1 + c["PEY5"] * gamma**2 - (c["PEY3"] + c["PEY4"] * gamma) * np.sign(alpha)
    e = (c["PEY1"] + c["PEY2"] * dfz) * e
    b = k / (c["PCY1"] * mu * fz)
    fy = mu * fz * np.sin(c["PCY1"] * shape_argument(b * alpha, e)) + s_v
    return {"fy": fy, "k": k, "mu": mu, "b": b, "s_h": s_h, "s_v": s_v}


def equivalent(alpha, slip):
    """(4.E77) and (4.E78), without the sign."""
    return np.arctan(np.hypot(np.tan(alpha), slip))


def pneumatic_trail(c, alpha, gamma, fz, dfz, dpi, slip):
    """t(alpha_t,eq), (4.E33), (4.E35) and (4.E40) to (4.E44)."""
    at = alpha + c["QHZ1"] + c["QHZ2"] * dfz + (c["QHZ3"] + c["QHZ4"] * dfz) * gamma
    b = c["QBZ1"] + c["QBZ2"] * dfz + c["QBZ3"] * dfz**2
    b = b * (1 + c["QBZ4"] * gamma + c["QBZ5"] * abs(gamma))
    d = fz * c["UNLOADED_RADIUS"] / c["FNOMIN"] * (c["QDZ1"] + c["QDZ2"] * dfz)
    d = d * (1 - c["PPZ1"] * dpi) * (1 + c["QDZ3"] * gamma + c["QDZ4"] * gamma**2)
    e = c["QEZ1"] + c["QEZ2"] * dfz + c["QEZ3"] * dfz**2
    bent = 2 / np.pi * np.arctan(b * c["QCZ1"] * at)
    e = e * (1 + (c["QEZ4"] + c["QEZ5"] * gamma) * bent)
    x = b * equivalent(at, slip)
    return d * np.cos(c["QCZ1"] * shape_argument(x, e)) * np.cos(alpha)


def residual_moment(c, alpha, gamma, fz, dfz, dpi, side, slip):
    """M_zr, (4.E36) to (4.E38) and (4.E45) to (4.E47)."""
    ar = alpha + side["s_h"] + side["s_v"] / side["k"]
    b = c["QBZ9"] + c["QBZ10"] * side["b"] * c["PCY1"]
    tilt = (c["QDZ8"] + c["QDZ9"] * dfz) * (1 + c["PPZ2"] * dpi)
    tilt = (tilt + (c["QDZ10"] + c["QDZ11"] * dfz) * abs(gamma)) * gamma
    d = fz * c["UNLOADED_RADIUS"] * (c["QDZ6"] + c["QDZ7"] * dfz + tilt)
    return d * np.cos(np.arctan(b * equivalent(ar, slip))) * np.cos(alpha)
