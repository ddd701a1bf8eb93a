"""S Figures 9, 10, 12, 14, 16, 19, 20 and 25, and the asserted numbers of their curves.

``python -m fits.source_figures.draw`` writes them to this folder.
"""

from pathlib import Path

import numpy as np

from fits.formulas import magic_formula
from fits.magic_formula_curve.make_data import SPEED
from fits.source_figures.curves import (
    ANGLES,
    CAR_LOAD,
    EXPANDED,
    FRICTIONS,
    HALF_LENGTH,
    INTERVAL,
    OPTIMISED,
    TIRES,
    TRUCK,
    convergence,
    expanded,
    force_slip,
    friction_curve,
    gough,
    optimised,
    optimised_curve,
    pressure_effect,
    pressures,
)
from fits.source_figures.taylor import radius
from tirefit.report.canvas import COLORS, DARK, GREY, Picture, tidy

HERE = Path(__file__).parent
LOAD = TRUCK["fz"]
# One grid per figure, for the drawing and for the asserted numbers.
SIGMA = np.linspace(0, 0.25, 25_001)
KAPPA = np.linspace(0, 1, 10_001)
ALPHA = np.arctan(np.linspace(0, 0.2, 20_001))
XI = np.linspace(-1, 1, 20_001)
TO_PEAK = np.linspace(0, 0.3, 3001)
TO_SLIDING = np.linspace(0, 0.25, 25_001)


def figure_9(picture: Picture) -> None:
    pair = picture.subplots(1, 2, sharey=True)
    for axes, family, words in zip(
        pair, ("brush", "uniform"), ("parabolic", "uniform"), strict=True
    ):
        for i, (mu, cpa2) in enumerate(TIRES):
            axes.plot(
                SIGMA,
                force_slip(family, mu, cpa2, SIGMA),
                color=COLORS[i],
                label=f"µ = {mu:g}, $c_p a^2$ = {cpa2 / 1e3:g} kN",
            )
        axes.set_title(f"{words} pressure, $F_z$ = 4 kN", fontsize=9)
        tidy(axes, "slip σ [–]", "$F_x / F_z$ [–]" if axes is pair[0] else "")


def figure_10(picture: Picture) -> None:
    axes = picture.subplots()
    axes.plot(
        100 * KAPPA,
        friction_curve(KAPPA),
        color=DARK,
        label="Magic Formula, D = 0.7, C = 2.5, B = 8, E = 1",
    )
    tidy(axes, "slip κ [%]", "$F / F_z$ [–]")


def figure_12(picture: Picture) -> None:
    axes = picture.subplots()
    for i, mu in enumerate(FRICTIONS):
        moment, force = gough(mu, ALPHA)
        axes.plot(1e3 * moment, force, color=COLORS[i], label=f"µ = {mu:g}")
    frictions = np.linspace(0.02, max(FRICTIONS), 400)
    for angle in ANGLES:
        moment, force = gough(frictions, np.deg2rad(angle))
        axes.plot(1e3 * moment, force, "--", color=GREY, linewidth=0.8)
    axes.lines[-1].set_label("slip angle held:\n½, 1, 2, 3, 4, 6°")
    tidy(axes, "$-M_z / F_z$ [mm], for a = 0.1 m", "$F_y / F_z$ [–]")
    axes.set_xlim(0, 14)


def figure_14(picture: Picture) -> None:
    axes = picture.subplots()
    curves = pressures(XI)
    for i, (name, density) in enumerate(curves.items()):
        axes.plot(
            XI, density, ("-", "--", "-.", "-.")[i], color=COLORS[i], label=name.replace("-", "−")
        )
    tidy(axes, "x / a [–]: trailing edge −1, leading edge +1", "$a\\, q_z / F_z$ [–]")


def figure_16(picture: Picture) -> None:
    axes = picture.subplots()
    curves = pressure_effect(TO_PEAK)
    for name, line, color in (
        ("Magic Formula", "-", DARK),
        ("fourth order", "--", COLORS[0]),
        ("parabolic", "-.", COLORS[1]),
    ):
        words = "Magic Formula (truck)" if color == DARK else f"brush, {name} pressure"
        axes.plot(100 * TO_PEAK, curves[name], line, color=color, label=words)
    tidy(axes, "slip κ [%]", "$F_x / F_z$ [–]")


def figure_19(picture: Picture) -> None:
    pair = picture.subplots(1, 2, sharey=True)
    for axes, name in zip(pair, EXPANDED, strict=True):
        _converging(axes, name)
        axes.set_title(f"d = {EXPANDED[name]:g}".replace("-", "−"), fontsize=9)
    pair[1].set_ylabel("")


def figure_20(picture: Picture) -> None:
    axes = picture.subplots()
    _converging(axes, "20")
    axes.set_title("$µ_0$ = 1.05, n = 0.0075 s/m, v = 20 m/s", fontsize=9)


def _converging(axes, name: str) -> None:
    curves = convergence(name, TO_SLIDING)
    styles = {"exact": ("-", DARK), "4 terms": ("--", COLORS[0]), "3 terms": ("-.", COLORS[1])}
    for label, (line, color) in styles.items():
        # A polynomial is not valid past full sliding.
        end = _sliding(name) if label != "exact" else len(TO_SLIDING)
        words = "brush" if label == "exact" else f"Taylor form, {label}"
        axes.plot(TO_SLIDING[:end], curves[label][:end], line, color=color, label=words)
    tidy(axes, "slip σ [–]", "$F_x / F_z$ [–]")


def figure_25(picture: Picture) -> None:
    axes = picture.subplots()
    axes.plot(
        100 * TO_PEAK,
        magic_formula(TO_PEAK, **TRUCK) / LOAD,
        color=DARK,
        linewidth=1.2,
        label="Magic Formula (truck)",
    )
    axes.plot(
        100 * INTERVAL,
        magic_formula(INTERVAL, **TRUCK) / LOAD,
        color=DARK,
        linewidth=3.5,
        label="optimised over",
    )
    for i, d in enumerate(OPTIMISED):
        for order, line in ((2, "-."), (3, ":")):
            axes.plot(
                100 * TO_PEAK,
                optimised_curve(d, order, TO_PEAK),
                line,
                color=COLORS[i],
                label=f"d = {d:g}, {order} terms".replace("-", "−"),
            )
    tidy(axes, "slip κ [%]", "$F_x / F_z$ [–]")


def _sliding(name: str) -> int:
    """Index of the first slip of Figure 19 or 20 at which all bristles slide."""
    exact, tire = convergence(name, TO_SLIDING)["exact"], expanded(name)
    level = tire.friction.kinetic(tire.mu, SPEED * TO_SLIDING / (1 + TO_SLIDING))
    return int(np.argmax(exact >= np.asarray(level) * (1 - 1e-13)))


def _of_9() -> dict[str, float]:
    found = {}
    for i, (mu, cpa2) in enumerate(TIRES):
        for family in ("brush", "uniform"):
            force = force_slip(family, mu, cpa2, SIGMA)
            key = f"9: {family} {i}:"
            found[f"{key} slope"] = force[1] / SIGMA[1]
            found[f"{key} force at sigma 0.03"] = np.interp(0.03, SIGMA, force)
        sliding = force_slip("brush", mu, cpa2, SIGMA) >= mu * (1 - 1e-13)
        found[f"9: brush {i}: sigma of full sliding"] = SIGMA[np.argmax(sliding)]
        straight = np.abs(force / (2 * cpa2 / CAR_LOAD * SIGMA + 1e-30) - 1) < 1e-9
        found[f"9: uniform {i}: last sigma all sticking"] = SIGMA[straight][-1]
    return found


def _of_10() -> dict[str, float]:
    force = friction_curve(KAPPA)
    half = np.flatnonzero(force >= 0.35)[0]
    return {
        "10: slope": friction_curve(1e-7) / 1e-7,
        "10: peak": force.max(),
        "10: kappa of the peak": KAPPA[np.argmax(force)],
        "10: kappa at half the peak": KAPPA[half],
        "10: locked wheel": force[-1],
    }


def _of_12() -> dict[str, float]:
    found = {}
    for mu in (0.4, 1.0):
        moment, force = gough(mu, ALPHA)
        best = int(np.argmax(moment))
        found[f"12: largest -M_z / (a F_z), mu = {mu:g}"] = moment[best] / HALF_LENGTH
        found[f"12: F_y / F_z there, mu = {mu:g}"] = force[best]
        gone = np.tan(ALPHA[np.argmax(moment[1:] <= 1e-15) + 1])
        found[f"12: tan alpha where M_z is gone, mu = {mu:g}"] = gone
        found[f"12: trail over a at rest, mu = {mu:g}"] = moment[1] / force[1] / HALF_LENGTH
    return found


def _of_14() -> dict[str, float]:
    found, curves = {}, pressures(XI)
    for name, density in curves.items():
        best = int(np.argmax(density))
        found[f"14: {name}: peak"] = density[best]
        found[f"14: {name}: x / a of the peak"] = XI[best]
        found[f"14: {name}: integral"] = np.trapezoid(density, XI)
        found[f"14: {name}: centre, x / a"] = np.trapezoid(XI * density, XI)
    ahead = curves["S(23)"] > curves["S(25)"]
    found["14: S(23) above S(25) to x / a"] = XI[ahead][-1]
    return found


def _of_16() -> dict[str, float]:
    curves = pressure_effect(TO_PEAK)
    gap = curves["fourth order"] - curves["parabolic"]
    found = {
        "16: largest lead of the parabolic": -gap.min(),
        "16: kappa of the largest lead": TO_PEAK[np.argmin(gap)],
        "16: fourth order at kappa 10 %": curves["fourth order"][1000],
    }
    to_70 = curves["Magic Formula"] <= 0.7 * TRUCK["D"]
    for name in ("parabolic", "fourth order"):
        miss = curves[name] - curves["Magic Formula"]
        worst = np.argmax(np.abs(miss[to_70]))
        found[f"16: {name}: largest miss to 70 % of the peak"] = miss[to_70][worst]
        found[f"16: {name}: kappa of full sliding"] = TO_PEAK[
            np.argmax(curves[name] >= TRUCK["D"] * (1 - 1e-12))
        ]
    return found


def _of_19_20() -> dict[str, float]:
    found = {}
    for name in (*EXPANDED, "20"):
        curves, end = convergence(name, TO_SLIDING), _sliding(name)
        found[f"{name}: sigma of full sliding"] = TO_SLIDING[end]
        for order in (3, 4):
            miss = curves[f"{order} terms"] - curves["exact"]
            found[f"{name}: miss of {order} terms at sigma 0.1"] = np.interp(0.1, TO_SLIDING, miss)
            found[f"{name}: sigma where {order} terms miss by 1 %"] = radius(
                expanded(name), LOAD, SPEED, order
            )
    moving = convergence("20", TO_SLIDING)["exact"]
    found["20: peak"] = moving.max()
    found["20: sigma of the peak"] = TO_SLIDING[np.argmax(moving)]
    return found


def _of_25() -> dict[str, float]:
    end = magic_formula(INTERVAL[-1], **TRUCK) / (TRUCK["D"] * LOAD)
    found = {"25: share of the peak at the end of the interval": end}
    for d in OPTIMISED:
        for order in (2, 3):
            cpa2, mu_fz = optimised(d, order)
            curve = optimised_curve(d, order, TO_PEAK)
            found[f"25: c_p a^2 [kN], d = {d:g}, {order} terms"] = cpa2 / 1e3
            found[f"25: mu, d = {d:g}, {order} terms"] = mu_fz / LOAD
            found[f"25: force at kappa 5 %, d = {d:g}, {order} terms"] = curve[500]
    return found


def properties() -> dict[str, float]:
    """Numbers of the drawn curves by name, as explained in expected.toml."""
    parts = (_of_9, _of_10, _of_12, _of_14, _of_16, _of_19_20, _of_25)
    return {name: float(value) for part in parts for name, value in part().items()}


FIGURES = {
    9: figure_9,
    10: figure_10,
    12: figure_12,
    14: figure_14,
    16: figure_16,
    19: figure_19,
    20: figure_20,
    25: figure_25,
}


def main() -> None:
    for number, figure in FIGURES.items():
        wide = number in (9, 19)
        picture = Picture(figsize=(7.0 if wide else 5.2, 3.4), layout="constrained")
        figure(picture)
        for axes in picture.axes:
            axes.set_ylim(bottom=0)
            if number != 12:
                axes.margins(x=0)
            place = "lower center" if number == 14 else "lower right"
            axes.legend(fontsize=6.5, frameon=False, loc=place)
        picture.savefig(HERE / f"figure_{number}.png")


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:60s} {value:.8g}")
