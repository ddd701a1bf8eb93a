"""S Figures 13, 15, 17 and 18, and the asserted numbers of their curves.

``python -m fits.magic_formula_curve.draw`` writes them to this folder.
S prints no coefficients for them: solid lines are the truck curve of ``make_data.py``,
in the lateral panel the coefficients of S Figure 10. Brush curves have its slope.
"""

from pathlib import Path

import jax
import numpy as np

import tirefit
from fits.formulas import magic_formula
from fits.magic_formula_curve.make_data import FIGURE10, SPEED, truck
from tirefit.report.canvas import COLORS, DARK, Picture, tidy

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
TRUCK = truck()
LOAD, STIFFNESS, PEAK = TRUCK["fz"], 2.5e5, TRUCK["D"]
KAPPA = np.linspace(0, 0.3, 601)
LINES = ("--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))


def brush(model: str, slip, fz: float = LOAD, force: str = "fx", **values):
    """Force [N] of a registered model at kappa, or tan(alpha) for ``fy``; (n,)."""
    tire = tirefit.with_values(tirefit.MODELS[model], {"cpa2": STIFFNESS, **values})
    if force == "fx":
        inputs = tirefit.TireInputs(slip / (1 - slip), 0.0, fz, SPEED)
    else:
        inputs = tirefit.TireInputs(0.0, np.arctan(slip), fz, SPEED)
    return np.asarray(getattr(tirefit.forces(tire, inputs), force))


def _similar(kappa, ratio: float):
    """The truck curve at another friction: lambda F(kappa / lambda)."""
    return ratio * magic_formula(kappa / ratio, **TRUCK)


def figure_13(picture: Picture) -> None:
    left, right = picture.subplots(1, 2)
    for i, ratio in enumerate((1.0, 0.5)):
        level = f"µ = {PEAK * ratio:.2f}"
        left.plot(
            100 * KAPPA,
            _similar(KAPPA, ratio) / 1e3,
            color=COLORS[i],
            label=f"Magic Formula, {level}",
        )
        left.plot(
            100 * KAPPA,
            brush("brush", KAPPA, mu=PEAK * ratio) / 1e3,
            "--",
            color=COLORS[i],
            label=f"brush, {level}",
        )
    tidy(left, "slip κ [%]", "brake force $F_x$ [kN]")
    angle = np.deg2rad(np.linspace(0, 16, 400))
    slope = FIGURE10["B"] * FIGURE10["C"] * FIGURE10["D"] * FIGURE10["fz"]
    right.plot(
        np.rad2deg(angle),
        magic_formula(angle, **FIGURE10) / 1e3,
        color=DARK,
        label="Magic Formula (S Figure 10)",
    )
    lateral = brush("brush", np.tan(angle), FIGURE10["fz"], "fy", cpa2=slope / 2, mu=FIGURE10["D"])
    right.plot(
        np.rad2deg(angle), lateral / 1e3, "--", color=COLORS[0], label="brush, same slope and peak"
    )
    tidy(right, "slip angle α [°]", "side force $F_y$ [kN]")
    left.set_title("longitudinal, $F_z$ = 27 kN", fontsize=9)
    right.set_title("lateral, $F_z$ = 4 kN", fontsize=9)


def figure_15(picture: Picture) -> None:
    axes = _with_truck(picture)
    named = {"−1/3": -1 / 3, "−0.15": -0.15, "0": 0.0, "0.4": 0.4, "1": 1.0}
    for i, (name, d) in enumerate(named.items()):
        axes.plot(
            100 * KAPPA,
            brush("brush-d", KAPPA, mu=PEAK, d=d) / 1e3,
            linestyle=LINES[i % 4],
            color=COLORS[i],
            label=f"brush-d, d = {name}",
        )


def figure_17(picture: Picture) -> None:
    axes = _with_truck(picture)
    for i, m in enumerate((1.0, 0.8, 0.6)):
        force = brush("brush-m-peak", KAPPA, mu_peak=PEAK, m=m)
        axes.plot(
            100 * KAPPA,
            force / 1e3,
            linestyle=LINES[i],
            color=COLORS[i],
            label=f"brush-m-peak, m = {m:g}, peak held",
        )


def figure_18(picture: Picture) -> None:
    left, right = picture.subplots(1, 2, sharey=True)
    for axes, title in ((left, "linear in speed"), (right, "exponential in speed")):
        _truck_line(axes)
        tidy(axes, "slip κ [%]", "brake force $F_x$ [kN]" if axes is left else "")
        axes.set_title(f"{title}, v = {SPEED:g} m/s", fontsize=9)
    for i, n in enumerate((0.0075, 0.015)):
        for model, line, words in (
            ("brush-n", "-", "$µ_s = µ_0$"),
            ("brush-ns", "o", "$µ_s = µ_k$"),
        ):
            left.plot(
                100 * KAPPA,
                brush(model, KAPPA, mu=1.05, n=n) / 1e3,
                line,
                color=COLORS[i],
                markevery=30,
                markersize=3.5,
                mfc="none",
                label=f"n = {n:g} s/m, {words}",
            )
    for i, (model, words) in enumerate((("brush-h", "$µ_s = µ_0$"), ("brush-hs", "$µ_s = µ_k$"))):
        right.plot(
            100 * KAPPA,
            brush(model, KAPPA, mu=1.3, h=0.4) / 1e3,
            LINES[i],
            color=COLORS[i],
            label=f"h = 0.4, µ = 1.3, {words}",
        )


def _truck_line(axes) -> None:
    axes.plot(
        100 * KAPPA, magic_formula(KAPPA, **TRUCK) / 1e3, color=DARK, label="Magic Formula (truck)"
    )


def _with_truck(picture: Picture):
    axes = picture.subplots()
    _truck_line(axes)
    tidy(axes, "slip κ [%]", "brake force $F_x$ [kN]")
    return axes


def _full_sliding(d: float) -> float:
    """First sigma at which the force stays at mu F_z."""
    sigma = np.linspace(0, 0.5, 100_001)
    force = brush("brush-d", sigma / (1 + sigma), mu=PEAK, d=d)
    return float(sigma[np.argmax(force >= PEAK * LOAD * (1 - 1e-13))])


def _peak(model: str, **values) -> tuple[float, float]:
    """(sigma, F/F_z) at the peak."""
    sigma = np.linspace(0, 0.5, 100_001)
    force = brush(model, sigma / (1 + sigma), **values)
    best = int(np.argmax(force))
    return float(sigma[best]), float(force[best] / LOAD)


def properties() -> dict[str, float]:
    """Numbers of the drawn curves by name, as explained in expected.toml."""
    fine = np.linspace(0, 0.999, 999_001)
    curve, small = magic_formula(fine, **TRUCK), np.array([1e-6])
    car = magic_formula(fine, **FIGURE10)
    found = {
        "truck: share of the peak at kappa 4 %": magic_formula(0.04, **TRUCK) / curve.max(),
        "truck: slope [N]": magic_formula(1e-6, **TRUCK) / 1e-6,
        "truck: kappa of the peak": fine[np.argmax(curve)],
        "figure 10: kappa of the peak": fine[np.argmax(car)],
        "13: brush slope [N]": brush("brush", small, mu=PEAK)[0] / 1e-6,
    }
    half = fine[fine < 0.3]
    ahead = brush("brush", half, mu=PEAK) - magic_formula(half, **TRUCK)
    found["13: kappa where the brush passes the curve"] = half[
        np.flatnonzero((ahead[1:] > 0) & (ahead[:-1] <= 0))[-1]
    ]
    found["13: largest lead of the brush over the peak"] = ahead.max() / (PEAK * LOAD)
    for name, d in (("-1/3", -1 / 3), ("0", 0.0), ("1", 1.0)):
        found[f"15: sigma of full sliding, d = {name}"] = _full_sliding(d)
    for m in (0.8, 0.6):
        sigma, peak = _peak("brush-m-peak", mu_peak=PEAK, m=m)
        found[f"17: peak over load, m = {m}"] = peak
        found[f"17: sigma of the peak, m = {m}"] = sigma
    beyond = brush("brush-m-peak", np.array([0.25]), mu_peak=PEAK, m=0.6)
    found["17: force over load in full sliding, m = 0.6"] = beyond[0] / LOAD
    for law, values in (("n", {"mu": 1.05, "n": 0.0075}), ("h", {"mu": 1.3, "h": 0.4})):
        constant = brush(f"brush-{law}", KAPPA, **values)
        following = brush(f"brush-{law}s", KAPPA, **values)
        gap = np.abs(constant - following).max() / constant.max()
        found[f"18: largest gap between the {law} curves over the peak"] = gap
        found[f"18: peak over load, {law}"] = _peak(f"brush-{law}", **values)[1]
        found[f"18: force over load at kappa 30 %, {law}"] = constant[-1] / LOAD
    return {name: float(value) for name, value in found.items()}


FIGURES = {13: figure_13, 15: figure_15, 17: figure_17, 18: figure_18}


def main() -> None:
    for number, figure in FIGURES.items():
        wide = number in (13, 18)
        picture = Picture(figsize=(7.0 if wide else 5.2, 3.4), layout="constrained")
        figure(picture)
        for axes in picture.axes:
            axes.set_ylim(bottom=0)
            axes.margins(x=0)
            axes.legend(fontsize=6.5, frameon=False, loc="lower right")
        picture.savefig(HERE / f"figure_{number}.png")


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:60s} {value:.7g}")
