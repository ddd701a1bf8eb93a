"""The figure and the asserted numbers of the diagnosis.

``python -m fits.dart_simulator.draw`` writes ``ladder.png`` to this folder.
"""

from pathlib import Path

import jax
import numpy as np

import tirefit
from tirefit.diagnosis.effects import EFFECTS

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent


def diagnosed():
    """Diagnosis of free driving with the unchanged fit of the circles of another day."""
    circles, driving = (
        tirefit.read(HERE / f"{name}.csv", convention="braking")
        for name in ("circles", "free_driving")
    )
    simulator = tirefit.fit(circles, "brush")
    # The heading offset, known from the other logs and also fitted by SciPy.
    heading = [effect for effect in EFFECTS if effect.id == "slip_offset"]
    return tirefit.diagnose(driving, sim=simulator, effects=heading)


def properties() -> dict:
    found = diagnosed()
    parts = {part.part: part for part in found.budget}
    changes = found.verdict.parameters
    fy = found.table["fy"]
    values = {
        "effects": list(found.effects),
        "sum of the shares": sum(part.share for part in found.budget),
        "noise and what has no name": float(np.hypot(parts["noise"].rms, parts["unexplained"].rms)),
    }
    for name in ("sim", "tuned"):
        missed = fy - found.rows["fy"][name]
        values[f"rms of measured less {name}"] = float(np.sqrt(np.nanmean(missed**2)))
    for name, change in changes.items():
        values[f"{name}: simulated"] = change.simulated
        values[f"{name}: with the effect"] = found.extended_parameters[name]
        values[f"{name}: interval"] = [
            change.measured - 2 * change.std,
            change.measured + 2 * change.std,
        ]
        values[f"{name}: differs"] = change.differs
    for name in ("parameters", "slip_offset"):
        values[f"share of {name}"] = parts[name].share if name in parts else 0.0
    return values


def main() -> None:
    diagnosed().plot("ladder").savefig(HERE / "ladder.png")


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:50s} {value}")
