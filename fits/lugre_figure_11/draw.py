"""S Figure 11, and the asserted numbers of its curves.

``python -m fits.lugre_figure_11.draw`` writes it to this folder. The LuGre curve is
tirefit's, with the parameters that SciPy fits to the Magic Formula (reference.py).
"""

from pathlib import Path

import jax
import numpy as np

import tirefit
from fits.formulas import magic_formula
from fits.lugre_figure_11.make_data import TRUTH
from fits.lugre_figure_11.reference import reference
from fits.magic_formula_curve.make_data import FIGURE10, SPEED
from tirefit.report.canvas import COLORS, DARK, Picture, tidy

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
LOAD = FIGURE10["fz"]


def curves(kappa):
    """F_x / F_z of the Magic Formula and of the LuGre tire fitted to it, (n,) each."""
    found = reference()
    tire = tirefit.with_values(tirefit.MODELS["lugre"], {name: found[name] for name in TRUTH})
    inputs = tirefit.TireInputs(kappa / (1 - kappa), 0.0, LOAD, SPEED)
    fitted = np.asarray(tirefit.forces(tire, inputs).fx)
    return magic_formula(kappa, **FIGURE10) / LOAD, fitted / LOAD


def properties() -> dict[str, float]:
    """Numbers of the drawn curves by name, as explained in expected.toml."""
    kappa = np.linspace(0, 1, 20_001)[1:-1]
    found = {}
    pair = curves(kappa)
    for name, force in zip(("Magic Formula", "LuGre"), pair, strict=True):
        found[f"{name}: kappa of the peak"] = kappa[np.argmax(force)]
        found[f"{name}: peak over load"] = force.max()
        found[f"{name}: force over load at kappa 99 %"] = np.interp(0.99, kappa, force)
    rows = curves(np.linspace(0, 1, 201)[1:-1])
    found["largest gap over load"] = np.abs(rows[1] - rows[0]).max()
    return {name: float(value) for name, value in found.items()}


def main() -> None:
    kappa = np.linspace(0, 1, 1001)[1:-1]
    formula, lugre = curves(kappa)
    picture = Picture(figsize=(5.2, 4.2), layout="constrained")
    above, below = picture.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 1]})
    above.plot(100 * kappa, formula, color=DARK, label="Magic Formula (S Figure 10)")
    above.plot(100 * kappa, lugre, "--", color=COLORS[1], label="LuGre, S(18), fitted")
    above.set_ylim(0, 0.8)
    above.legend(fontsize=8, frameon=False, loc="lower right")
    tidy(above, "", "$F_x / F_z$ [–]")
    below.axhline(0, color=DARK, linewidth=0.8)
    below.plot(100 * kappa, 100 * (lugre - formula), color=COLORS[1])
    tidy(below, "slip κ [%]", "gap [% of $F_z$]")
    below.margins(x=0)
    picture.savefig(HERE / "figure_11.png")


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:45s} {value:.7g}")
