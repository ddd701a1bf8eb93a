"""A tire read in the wrong signs is reported before any effect."""

from pathlib import Path

import numpy as np
import pytest

from tirefit.data.read import read_frame
from tirefit.data.tir.tir import read_tir
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.simulator import GivenSimulator, check_signs, simulator_at
from tirefit.diagnosis.rows.subject import fit_base
from tirefit.fitting.tir import tire_of
from tirefit.models import TireInputs, forces
from tirefit.results import DataError
from tirefit.slip import CONVENTIONS

TIR = Path(__file__).parents[1] / "data/tir/mfeval_julia/MagicFormula61_Parameters.tir"
FEW = tuple(effect for effect in EFFECTS if effect.id == "slip_offset")
NOISE = {"fx": 30.0, "fy": 30.0, "mz": 1.0}


def frame(channels="fy mz", cambers=(0.0,), offset=0.0, mu=1.0, forces_of=None, **how):
    """Sweeps at three loads and some cambers, of the file's tire read by ``how``; with
    an unmeasured slip offset and a friction that the file does not have."""
    generator, sweep = np.random.default_rng(3), np.linspace(-0.2, 0.2, 61)
    fz, gamma, slip = (
        part.ravel() for part in np.meshgrid((2e3, 4e3, 6e3), cambers, sweep, indexing="ij")
    )
    still = 0 * slip
    along = channels == "fx"
    at = TireInputs(
        slip + offset if along else still,
        still if along else slip + offset,
        fz,
        still + 16.6,
        gamma,
    )
    true = forces(tire_of(read_tir(TIR), **how), at)._asdict()
    columns = {"sigma_x" if along else "alpha": slip, "fz": fz, "gamma": gamma}
    for name in channels.split():
        noise = NOISE[name] * generator.standard_normal(len(slip))
        columns[name] = mu * np.asarray(true[name]) + noise
    return columns


RIG = Rig(noise=NOISE)


def rows_of(columns, given: GivenSimulator, **declared):
    data = given.beside(read_frame(columns, "rig", **declared))
    return prepare(data, RIG, given.channels(data, ("fx", "fy", "mz")))


def doubt(columns, given: GivenSimulator, stand_in: GivenSimulator | None = None, **declared):
    """The message about the signs, without the fit that follows it."""
    prepared = rows_of(columns, given, **declared)
    tire, z, _ = (stand_in or given).tire_for(prepared, FEW)
    return check_signs(prepared, tire, z, given)


def refused(*arguments, check=doubt, **declared):
    with pytest.raises(DataError) as caught:
        check(*arguments, **declared)
    (problem,) = caught.value.problems
    return problem.reason, problem.remedy


BRAKING = {"convention": "braking"}


@pytest.mark.parametrize("mu", [1.0, 0.85])
def test_a_tire_in_sae_signs_is_reported_with_a_remedy(mu):
    columns = frame(signs="sae", mu=mu)
    reason, remedy = refused(columns, simulator_at(str(TIR)), **BRAKING)
    assert "mirrored in alpha and fy and mz" in reason
    # By hand: as it is, and as SAE.
    wrong, right = (frame(signs=signs)["fy"] for signs in (None, "sae"))
    before, after = (np.sqrt(np.mean((columns["fy"] - f) ** 2)) for f in (wrong, right))
    if mu == 1.0:
        assert f"fy {before:.2g}"[:4] in reason and before > 4 * NOISE["fy"] > after
    assert "--signs sae reads the file in these signs" in remedy and "--side" in remedy
    assert "--convention" not in remedy
    assert doubt(columns, simulator_at(str(TIR), signs="sae"), **BRAKING) == ""
    # The warning is given even if the user insists.
    said = doubt(columns, simulator_at(str(TIR), signs="iso-w"), **BRAKING)
    assert "mirrored in alpha" in said and "used as given" in said


@pytest.mark.long
def test_camber_distinguishes_sae_from_a_mirrored_tire():
    cambers = (0.0, 0.06)
    given = simulator_at(str(TIR))
    # Such a tire leans the wrong way: the reader warns, and the tire is the evidence.
    reason, remedy = refused(frame(cambers=cambers, signs="sae"), given, **BRAKING)
    assert "--signs sae" in remedy and "--side" not in remedy
    columns = frame(cambers=cambers, side="left")
    reason, remedy = refused(columns, given, **BRAKING)
    assert "mirrored in alpha and gamma and fy and mz" in reason
    assert "--side, if" in remedy and "--signs sae" not in remedy
    assert doubt(columns, simulator_at(str(TIR), side="left"), **BRAKING) == ""
    columns = frame(cambers=cambers)
    reason, remedy = refused(columns | {"gamma": -columns["gamma"]}, given, **BRAKING)
    assert "mirrored in gamma:" in reason and "--unit gamma=-rad" in remedy


def test_a_moment_of_the_other_sign_is_reported():
    """As in a diagnosis, which fits its base first."""

    def fitted(columns, given, **declared):
        fit_base(rows_of(columns, given, **declared), None, FEW, RIG, given)

    columns = frame()
    turned = columns | {"mz": -columns["mz"]}
    reason, remedy = refused(turned, simulator_at(str(TIR)), check=fitted, **BRAKING)
    assert "mirrored in mz: mz" in reason and "--unit mz=-Nm" in remedy


def test_undeclared_data_may_have_the_wrong_signs():
    columns = frame("fx")
    given = simulator_at(str(TIR))
    assert given.otherwise == ("iso-w", ".tir files")
    iso = {**columns, "sigma_x": -columns["sigma_x"], "fx": -columns["fx"]}
    assert doubt(iso, given, otherwise=given.otherwise) == ""
    reason, remedy = refused(columns, given, otherwise=given.otherwise)
    assert "mirrored in sigma_x and fx: fx" in reason
    assert "--convention braking does so for the data, which declare none" in remedy
    assert "--signs braking" in remedy
    assert doubt(columns, given, **BRAKING) == ""


OTHER_GAPS = {
    "nothing": {},
    "an offset of the slip": {"offset": 0.004},
    "an offset the other way": {"offset": -0.004},
    "friction and an offset": {"offset": 0.002, "mu": 0.85},
    "longitudinal": {"channels": "fx", "offset": 0.004},
    "under camber": {"cambers": (-0.05, 0.05), "offset": 0.003, "mu": 1.1},
}


@pytest.mark.parametrize("gap", OTHER_GAPS.values(), ids=OTHER_GAPS)
def test_other_gaps_are_not_reported_as_wrong_signs(gap):
    assert doubt(frame(**gap), simulator_at(str(TIR)), **BRAKING) == ""


def test_columns_of_a_mirrored_simulator_are_reported():
    """Only the forces are known; the approximating tire is mirrored."""
    columns = frame("fy")
    simulated = frame("fy", signs="sae", mu=1.0)["fy"]
    given = GivenSimulator(kind="columns", source="columns")
    beside, sae = columns | {"fy_sim": simulated}, simulator_at(str(TIR), signs="sae")
    reason, remedy = refused(beside, given, sae, **BRAKING)
    assert "mirrored in alpha and fy" in reason and "in the simulator" in remedy
    kept = GivenSimulator(kind="columns", source="columns", signs="braking")
    assert "mirrored in alpha and fy" in doubt(beside, kept, sae, **BRAKING)
    larger = columns | {"fy_sim": columns["fy"] * 1.1}
    assert doubt(larger, given, simulator_at(str(TIR)), **BRAKING) == ""


@pytest.mark.parametrize("signs", ["braking", "iso-w"])
def test_simulated_columns_may_have_other_signs(signs):
    """Than those of the file, in whose signs they were read."""
    columns = {k: getattr(CONVENTIONS[signs], k) * x for k, x in frame().items()}
    raw = columns["fy"]
    data = read_frame(columns | {"fy_sim": raw}, convention=signs)
    for name, convention in CONVENTIONS.items():
        given = GivenSimulator(kind="columns", source="columns", signs=name)
        np.testing.assert_array_equal(given.beside(data)["fy_sim"], convention.fy * raw)
