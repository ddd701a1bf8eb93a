"""The tire formulas of gymkhana 1.2.0, ``gymkhana/envs/dynamic_models/tire_model.py``.

The package itself installs a simulator with windows and cameras, so its one file of
formulas is here, with shorter comments. Its licence:

MIT License

Copyright (c) 2026 Teodor Ilie
Copyright (c) 2023 Hongrui Zheng, Renukanandan Tumu, Luigi Berducci, Ahmad Amine
Copyright (c) 2020 Joseph Auckley, Matthew O'Kelly, Aman Sinha, Hongrui Zheng

Permission is hereby granted, free of charge, to any person obtaining a copy
of this software and associated documentation files (the "Software"), to deal
in the Software without restriction, including without limitation the rights
to use, copy, modify, merge, publish, distribute, sublicense, and/or sell
copies of the Software, and to permit persons to whom the Software is
furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.
"""

import numpy as np


# longitudinal tire forces
def formula_longitudinal(kappa, gamma, F_z, params: dict):
    # longitudinal coefficients
    tire_p_cx1 = params["tire_p_cx1"]
    tire_p_dx1 = params["tire_p_dx1"]
    tire_p_dx3 = params["tire_p_dx3"]
    tire_p_ex1 = params["tire_p_ex1"]
    tire_p_kx1 = params["tire_p_kx1"]
    tire_p_hx1 = params["tire_p_hx1"]
    tire_p_vx1 = params["tire_p_vx1"]

    # turn slip is neglected, so xi_i=1
    # all scaling factors lambda = 1

    # coordinate system transformation
    kappa = -kappa

    S_hx = tire_p_hx1
    S_vx = F_z * tire_p_vx1

    kappa_x = kappa + S_hx
    mu_x = tire_p_dx1 * (1 - tire_p_dx3 * gamma**2)

    C_x = tire_p_cx1
    D_x = mu_x * F_z
    E_x = tire_p_ex1
    K_x = F_z * tire_p_kx1
    B_x = K_x / (C_x * D_x)

    # magic tire formula
    return D_x * np.sin(
        C_x * np.arctan(B_x * kappa_x - E_x * (B_x * kappa_x - np.arctan(B_x * kappa_x))) + S_vx
    )


# lateral tire forces
def formula_lateral(alpha, gamma, F_z, params: dict):
    # lateral coefficients
    tire_p_cy1 = params["tire_p_cy1"]
    tire_p_dy1 = params["tire_p_dy1"]
    tire_p_dy3 = params["tire_p_dy3"]
    tire_p_ey1 = params["tire_p_ey1"]
    tire_p_ky1 = params["tire_p_ky1"]
    tire_p_hy1 = params["tire_p_hy1"]
    tire_p_hy3 = params["tire_p_hy3"]
    tire_p_vy1 = params["tire_p_vy1"]
    tire_p_vy3 = params["tire_p_vy3"]

    # turn slip is neglected, so xi_i=1
    # all scaling factors lambda = 1

    # coordinate system transformation
    # alpha = -alpha

    S_hy = np.sign(gamma) * (tire_p_hy1 + tire_p_hy3 * np.fabs(gamma))
    S_vy = np.sign(gamma) * F_z * (tire_p_vy1 + tire_p_vy3 * np.fabs(gamma))

    alpha_y = alpha + S_hy
    mu_y = tire_p_dy1 * (1 - tire_p_dy3 * gamma**2)

    C_y = tire_p_cy1
    D_y = mu_y * F_z
    E_y = tire_p_ey1
    K_y = F_z * tire_p_ky1  # simplify K_y0 to tire_p_ky1*F_z
    B_y = K_y / (C_y * D_y)

    # magic tire formula
    F_y = (
        D_y
        * np.sin(C_y * np.arctan(B_y * alpha_y - E_y * (B_y * alpha_y - np.arctan(B_y * alpha_y))))
        + S_vy
    )

    res = []
    res.append(F_y)
    res.append(mu_y)
    return res


# longitudinal tire forces for combined slip
def formula_longitudinal_comb(kappa, alpha, F0_x, params: dict):
    # longitudinal coefficients
    tire_r_bx1 = params["tire_r_bx1"]
    tire_r_bx2 = params["tire_r_bx2"]
    tire_r_cx1 = params["tire_r_cx1"]
    tire_r_ex1 = params["tire_r_ex1"]
    tire_r_hx1 = params["tire_r_hx1"]

    # turn slip '' neglected, so xi_i=1
    # all scaling factors lambda = 1

    S_hxalpha = tire_r_hx1

    alpha_s = alpha + S_hxalpha

    B_xalpha = tire_r_bx1 * np.cos(np.arctan(tire_r_bx2 * kappa))
    C_xalpha = tire_r_cx1
    E_xalpha = tire_r_ex1
    D_xalpha = F0_x / (
        np.cos(
            C_xalpha
            * np.arctan(
                B_xalpha * S_hxalpha
                - E_xalpha * (B_xalpha * S_hxalpha - np.arctan(B_xalpha * S_hxalpha))
            )
        )
    )

    # magic tire formula
    return D_xalpha * np.cos(
        C_xalpha
        * np.arctan(
            B_xalpha * alpha_s - E_xalpha * (B_xalpha * alpha_s - np.arctan(B_xalpha * alpha_s))
        )
    )


# lateral tire forces for combined slip
def formula_lateral_comb(kappa, alpha, gamma, mu_y, F_z, F0_y, params: dict):
    # lateral coefficients
    tire_r_by1 = params["tire_r_by1"]
    tire_r_by2 = params["tire_r_by2"]
    tire_r_by3 = params["tire_r_by3"]
    tire_r_cy1 = params["tire_r_cy1"]
    tire_r_ey1 = params["tire_r_ey1"]
    tire_r_hy1 = params["tire_r_hy1"]
    tire_r_vy1 = params["tire_r_vy1"]
    tire_r_vy3 = params["tire_r_vy3"]
    tire_r_vy4 = params["tire_r_vy4"]
    tire_r_vy5 = params["tire_r_vy5"]
    tire_r_vy6 = params["tire_r_vy6"]

    # turn slip is neglected, so xi_i=1
    # all scaling factors lambda = 1

    S_hykappa = tire_r_hy1

    kappa_s = kappa + S_hykappa

    B_ykappa = tire_r_by1 * np.cos(np.arctan(tire_r_by2 * (alpha - tire_r_by3)))
    C_ykappa = tire_r_cy1
    E_ykappa = tire_r_ey1
    D_ykappa = F0_y / (
        np.cos(
            C_ykappa
            * np.arctan(
                B_ykappa * S_hykappa
                - E_ykappa * (B_ykappa * S_hykappa - np.arctan(B_ykappa * S_hykappa))
            )
        )
    )

    D_vykappa = (
        mu_y * F_z * (tire_r_vy1 + tire_r_vy3 * gamma) * np.cos(np.arctan(tire_r_vy4 * alpha))
    )
    S_vykappa = D_vykappa * np.sin(tire_r_vy5 * np.arctan(tire_r_vy6 * kappa))

    # magic tire formula
    return (
        D_ykappa
        * np.cos(
            C_ykappa
            * np.arctan(
                B_ykappa * kappa_s - E_ykappa * (B_ykappa * kappa_s - np.arctan(B_ykappa * kappa_s))
            )
        )
        + S_vykappa
    )
