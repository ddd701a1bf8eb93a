"""The generator of fits/withheld agrees with closed forms, quadrature and analysis."""

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from fits import formulas
from fits.withheld import effects, forms_rig, generate, injected, library, patch, strange, trials
from fits.withheld.designs import DESIGNS, make_world
from fits.withheld.effects import EFFECTS
from fits.withheld.patch import World

FOLDER = Path(generate.__file__).parent
C, MU = 5e4, 0.9
NOTHING = np.random.default_rng(0)


def steady(slip, fz=4000.0, v=15.0, force="fx", **given):
    """A world of steady points."""
    slip = np.asarray(slip, float)
    ones = np.ones(len(slip))
    time = np.arange(len(slip)) * 0.5
    return World(time, np.zeros(len(slip), int), slip, fz * ones, v * ones, force, C, MU, **given)


def sweep(n=2001, speed=10.0):
    """A ramp of the slip, 0 to 0.1 in 2 s."""
    time = np.linspace(0, 2, n)
    ones = np.ones(n)
    return World(time, np.zeros(n, int), 0.05 * time, 4000 * ones, speed * ones, "fx", C, MU)


def changed(world, effect, form, amplitude):
    EFFECTS[effect].forms[form](world, amplitude, NOTHING)
    return patch.forces(world)


SLIPS = np.array([0.002, 0.02, 0.05, 0.08, 0.1, 0.15, 0.3])


@pytest.mark.parametrize(
    ("effect", "form", "amplitude", "closed"),
    [
        ("pressure_asymmetry", "skewed", 0.3,
         lambda s, z, v: formulas.brush_d(s, z, v, C, MU, 0.3)),
        ("pressure_asymmetry", "skewed", -0.3,
         lambda s, z, v: formulas.brush_d(s, z, v, C, MU, -0.3)),
        ("kinetic_friction", "two_frictions", 0.25,
         lambda s, z, v: formulas.brush_m(s, z, v, C, MU, 0.75)),
        ("load_friction", "friction_power", -0.1,
         lambda s, z, v: formulas.brush(s, z, v, C, MU * (z / 4000) ** -0.1)),
        ("load_stiffness", "stiffness_power", 0.4,
         lambda s, z, v: formulas.brush(s, z, v, C * (z / 4000) ** 0.4, MU)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("load", [2000.0, 6000.0])
def test_the_patch_agrees_with_the_closed_form(effect, form, amplitude, closed, load):
    world = steady(SLIPS, load)
    found = changed(world, effect, form, amplitude)["fx"]
    assert found == pytest.approx(closed(SLIPS, load, 15.0), abs=1e-3 * MU * load)


@pytest.mark.parametrize(
    ("effect", "form", "amplitude", "friction"),
    [
        ("friction_speed_linear", "speed_linear", 0.01, lambda u: MU - 0.01 * u),
        (
            "friction_speed_exponential",
            "speed_root",
            0.15,
            lambda u: MU * (0.625 + 0.375 * np.exp(-np.sqrt(u / 30))),
        ),
    ],
)
def test_friction_falls_with_sliding_speed(effect, form, amplitude, friction):
    # Both levels fall, S(35) and S(37): the plain brush at the friction of that speed.
    found = changed(steady(SLIPS, v=30.0), effect, form, amplitude)["fx"]
    speed = 30 * SLIPS / (1 + SLIPS)
    closed = formulas.brush(SLIPS, 4000.0, 30.0, C, friction(speed))
    assert found == pytest.approx(closed, abs=4)


def by_quadrature(density, slip, mu_s, mu_k, load=4000.0):
    """Force and moment by adaptive quadrature and a root for the breakaway point."""

    def excess(xi):
        return C * slip * (1 - xi) - mu_s * load * density(xi)

    inside = np.linspace(1 - 1e-6, -1, 4001)
    sliding = [xi for xi in inside if excess(xi) > 0]
    first = sliding[0] if sliding else -1.0
    if sliding and first < inside[0]:
        first = brentq(excess, first, inside[list(inside).index(first) - 1])

    def stress(xi):
        held = C * slip * (1 - xi)
        return held if xi > first else mu_k * load * density(xi)

    force = quad(stress, -1, 1, points=[first])[0]
    moment = quad(lambda xi: xi * stress(xi), -1, 1, points=[first])[0]
    return force, patch.HALF_LENGTH * moment


@pytest.mark.parametrize(
    ("effect", "form", "amplitude", "density"),
    [
        ("pressure_flatness", "quartic_mix", 1.0, lambda x: 0.625 * (1 - x**4)),
        (
            "pressure_flatness",
            "quartic_mix",
            0.5,
            lambda x: 0.375 * (1 - x**2) + 0.3125 * (1 - x**4),
        ),
        (
            "pressure_asymmetry",
            "skewed_beta",
            0.5,
            lambda x: max((1 + x), 0) ** 1.2 * max(1 - x, 0) ** 0.8 / 1.2937,
        ),
        ("pressure_asymmetry", "skewed", 0.4, lambda x: 0.75 * (1 - x**2) * (1 + 0.4 * x)),
    ],
)
def test_the_patch_agrees_with_the_integral(effect, form, amplitude, density):
    slips = np.array([0.03, 0.06, 0.1])
    world = steady(slips, force="fy", moment=True)
    found = changed(world, effect, form, amplitude)
    total = quad(density, -1, 1)[0]
    for k, slip in enumerate(slips):
        wanted = by_quadrature(lambda x: density(x) / total, slip, MU, MU)
        assert found["fy"][k] == pytest.approx(wanted[0], abs=4)
        assert found["mz"][k] == pytest.approx(wanted[1], abs=0.4)


def test_the_plain_brush_agrees_with_the_patch():
    slip = np.array([-0.2, -0.03, 0.0, 0.01, 0.05, 0.2])
    world = steady(slip, force="fy", moment=True)
    found, closed = patch.forces(world), patch.plain_brush(slip, world.fz, C, MU)
    assert found["fy"] == pytest.approx(closed[0], abs=2)
    assert found["mz"] == pytest.approx(closed[1], abs=0.2)
    assert closed[1][4] < 0  # the force acts behind the centre


def test_the_carcass_absorbs_its_share_of_the_slip():
    # While all bristles stick, F = 2 c (slip - chi F) in both forms.
    chi = 0.01 / (MU * 4000)
    for form in ("carcass_slip", "carcass_bow"):
        world = steady([0.001])
        found = changed(world, "carcass_flexibility", form, 0.01)["fx"]
        assert found == pytest.approx(2 * C * 0.001 / (1 + 2 * C * chi), rel=2e-2)


def test_lag_solves_its_equation():
    # dy/dt = (v/L)(x - y) on a ramp x = k t: y = k (t - T (1 - exp(-t/T))), T = L/v.
    world = sweep()
    lag = 0.5 / 10
    found = patch.lagged(world, world.slip, world.v / 0.5)
    wanted = 0.05 * (world.time - lag * (1 - np.exp(-world.time / lag)))
    assert found == pytest.approx(wanted, abs=1e-8)


def test_delay_shifts_within_runs():
    world = sweep()
    plain = patch.forces(sweep())["fx"]
    found = changed(world, "channel_delay", "delay", 0.02)["fx"]
    assert found[20:] == pytest.approx(plain[:-20], abs=1)
    assert found[0] == plain[0]


def test_the_inertia_effect_is_the_torque_of_wheel_acceleration():
    # v_wheel = v/(1+s), s = k t: dv_wheel/dt = -v k/(1+s)^2.
    world = sweep()
    plain = patch.forces(sweep())["fx"]
    found = changed(world, "wheel_inertia", "inertia", 11.0)["fx"]
    wanted = 11.0 * 10 * 0.05 / (1 + world.slip) ** 2
    assert (found - plain)[1:-1] == pytest.approx(wanted[1:-1], rel=1e-3)


def test_combined_slip_is_isotropic():
    slip = np.array([0.02, 0.04])
    world = steady(slip)
    world.cross = np.array([0.05, 0.05])
    found = changed(world, "combined_slip", "combined", 0.05)["fx"]
    size = np.hypot(slip, 0.05)
    wanted = patch.plain_brush(size, world.fz, C, MU)[0] * slip / size
    assert found == pytest.approx(wanted, abs=2)


def test_lugre_agrees_with_the_sum_of_its_bristles():
    # z(x) = (g/sigma0)(1 - exp(-sigma0 slip x/g)) along the patch, S(17) at rest.
    world = steady([0.01, 0.05, 0.2])
    strange.lugre(world, 0, np.random.default_rng(3))
    g = np.random.default_rng(3)
    ratio, knee = g.uniform(1.15, 1.5), g.uniform(2, 6)
    found = patch.forces(world)["fx"]
    length, sigma0 = 0.2, 4 * C / (4000 * 0.2)
    for slip, force in zip(world.slip, found, strict=True):
        speed = 15 * slip / (1 + slip)
        level = MU * (1 + (ratio - 1) * np.exp(-np.sqrt(speed / knee)))
        stress = quad(lambda x, s=slip, n=level: n * -np.expm1(-sigma0 * s * x / n), 0, length)
        assert force == pytest.approx(4000 * stress[0] / length, rel=1e-6)


def test_a_load_cell_offset_acts_as_another_load():
    found = changed(steady(SLIPS, 3000.0), "load_offset", "load_zero", 0.06)["fx"]
    right = formulas.brush(SLIPS, 3240.0, 15.0, C, MU)
    assert found == pytest.approx(right, abs=3)


def test_the_lateral_force_reduces_friction_by_an_ellipse():
    world = steady(SLIPS, across=np.full(len(SLIPS), 0.6 * MU * 4000))
    found = changed(world, "friction_ellipse", "friction_ellipse", 1.0)["fx"]
    assert found == pytest.approx(formulas.brush(SLIPS, 4000.0, 15.0, C, 0.8 * MU), abs=4)


def test_a_speed_error_changes_the_computed_slip():
    """(v + a) / (omega R) - 1, from the speeds themselves."""
    world, zero = steady(SLIPS, v=8.0), 0.05
    EFFECTS["speed_zero"].forms["speed_is_off_of_wheel"](world, zero, NOTHING)
    rim = world.v / (1 + SLIPS)
    logged = world.logged[0](world, SLIPS)
    assert logged == pytest.approx((world.v + zero) / rim - 1, rel=1e-12)


def test_the_work_of_sliding_agrees_with_the_closed_form():
    """A ramp of the slip at full sliding: power, and so work, in closed form."""
    world = sweep()
    world.slip = world.slip + 0.2  # beyond full sliding, at 0.108
    found = forms_rig._work(world, None)
    slip = world.slip
    # v s / (1 + s) integrated over time, s = 0.2 + 0.05 t.
    right = (slip - np.log1p(slip)) - (slip[0] - np.log1p(slip[0]))
    right = (right - right.mean()) / np.ptp(right)
    assert found == pytest.approx(right, abs=2e-3)
    # What cools as fast as it is heated grows ever slower.
    faded = np.diff(forms_rig._work(world, 0.25))
    assert faded[-1] < 0.5 * faded[1] and np.diff(found)[-1] > np.diff(found)[1]


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_form_changes_the_force_or_the_slip(effect):
    about = EFFECTS[effect]
    design = next(d for d in DESIGNS.values() if about.needs <= d.properties | trials.COLUMNS)
    sizes = []
    for form in about.forms.values():
        g = np.random.default_rng(1)
        world = make_world(design, 180, C, MU, g)
        plain = patch.forces(world)
        form(world, about.typical * (about.sign or 1), g)
        found, slip = patch.forces(world), world.sensed
        for change in world.logged:
            slip = change(world, slip)
        moved = 2 * C * (slip - world.sensed)
        sizes.append(
            np.std(found[world.force] - plain[world.force])
            + np.std(moved)
            + abs(np.mean(moved))
            + abs(np.mean(found[world.force] - plain[world.force]))
        )
        assert np.all(np.isfinite(found[world.force]))
    # No form is another effect by size: within a factor of four of the textbook's.
    assert min(sizes) > 5
    assert max(sizes) < 4 * sizes[0]
    assert min(sizes) > sizes[0] / 4


def draws(seed, count=30, sets=("singles", "null", "unlisted"), sealed=False, **given):
    return trials.draw(
        seed, count, list(sets), given.get("designs"), ["rig", "seed"], [200], sealed
    )


def test_the_same_seed_gives_the_same_trials():
    first, second, other = draws(3, 9), draws(3, 9), draws(4, 9)
    assert [t.label for t in first] == [t.label for t in second]
    for a, b in zip(first, second, strict=True):
        assert all(np.array_equal(a.columns[key], b.columns[key]) for key in a.columns)
    assert [t.label for t in first] != [t.label for t in other]


def test_development_excludes_sealed_effects():
    def unseen(trial):
        label = trial.label
        if DESIGNS[label["design"]].sealed:
            return True
        pairs = zip(label["effects"], label["forms"], strict=True)
        return any(
            len(EFFECTS[e].forms) > 1 and form == list(EFFECTS[e].forms)[-1] for e, form in pairs
        )

    assert not any(unseen(trial) for trial in draws(5, 60, ["singles", "pairs"]))
    sealed = draws(1005, 120, ["singles", "pairs"], sealed=True)
    assert np.mean([unseen(trial) for trial in sealed]) >= 0.3


def test_at_least_22_effects_are_drawn():
    every = trials.Draw(NOTHING, list(trials.DEVELOPMENT), ["rig"], [200], False)
    possible = {e for design in trials.DEVELOPMENT for e in every.possible(design)}
    assert possible == set(EFFECTS)
    assert len(possible) >= 22


@pytest.fixture(scope="module")
def plain_trials():
    every = draws(12, 40, ["null"], designs=["C"])
    return [trial for trial in every if trial.label["kind"] == "iid"]


def test_noise_has_the_level_stated_in_the_rig_file(plain_trials):
    noises = {"rig": [], "seed": []}
    for trial in plain_trials:
        wrong = (trial.columns["fx"] - trial.truth["fx"]) / trial.columns["fz"]
        sliding = trial.columns["sigma_x"] > 0.2  # where the noise of the slip is lost
        noises[trial.label["noise"]].extend(wrong[sliding])
        assert trial.label["root_lambda"] < 0.2
    assert np.std(noises["rig"]) == pytest.approx(0.01, rel=0.15)
    assert np.std(noises["seed"]) == pytest.approx(0.2e-2**0.5, rel=0.15)


def test_the_truth_is_given_at_the_measured_slip(plain_trials):
    for trial in plain_trials:
        x, c, mu = trial.columns, trial.label["c"], trial.label["mu"]
        wanted = patch.plain_brush(x["sigma_x"], x["fz"], c, mu)[0]
        assert trial.truth["fx"] == pytest.approx(wanted, abs=5)


def inputs(world, **given):
    stds = (0.001, 0.01 * world.fz, 0.001 * world.fz)
    return library.Inputs(
        world.time, world.run, world.slip, world.fz, world.v, world.force, stds, **given
    )


@pytest.mark.parametrize(
    ("effect", "amplitude"), [("slip_offset", 0.004), ("slip_definition", 1.0)]
)
def test_the_library_reverses_logged_effects(effect, amplitude):
    world = make_world(DESIGNS["F"], 100, C, MU, np.random.default_rng(2))
    truth = patch.forces(world)["fx"]
    next(iter(EFFECTS[effect].forms.values()))(world, amplitude, NOTHING)
    world.slip = world.logged[0](world, world.sensed)
    found = library.predict(inputs(world), effect, amplitude, C, MU)
    assert found == pytest.approx(truth, abs=0.01)


def test_files_contain_no_label(tmp_path):
    digest = generate.write_all(draws(7, 14, list(trials.SETS)), tmp_path)
    assert (tmp_path / "labels.sha256").read_text().startswith(digest)
    labels = json.loads((tmp_path / "labels.json").read_text())
    files = sorted(path for path in tmp_path.glob("trials/*/*"))
    assert len(list(tmp_path.glob("trials/*/*.csv"))) == len(labels) == 16
    words = {*EFFECTS, *effects.NOISE_EFFECTS, "effect", "label", "ripple"}
    words -= {"wheel_inertia"}  # a property of every rig
    known = {"time", "sigma_x", "alpha", "fx", "fy", "mz", "fz", "v", "omega", "gamma",
             "temperature", "pressure", "run", "fx_sim", "fy_sim",
             "mz_sim"}  # fmt: skip
    for path in files:
        text = path.read_text()
        assert not words & set(re.findall(r"[a-z_]+", text))
        if path.suffix == ".csv":
            assert re.fullmatch(r"t\d{4}", path.stem)
            assert set(text.split("\n", 1)[0].split(",")) <= known
    truth = np.load(tmp_path / "truth.npz")
    for name, label in labels.items():
        has_truth = label["set"] not in ("injected", "raw")
        assert (f"{name}_{label['force']}" in truth) == has_truth


def test_seeds_are_distinct(tmp_path):
    common = ["--trials", "1", "--out", str(tmp_path), "--set", "null"]
    with pytest.raises(SystemExit):
        generate.main(["--seed", "5", "--sealed", *common])
    with pytest.raises(SystemExit):
        generate.main(["--seed", "1005", *common])
    assert not list(tmp_path.iterdir())


def test_injected_changes_have_the_stated_size():
    rows = injected.half(0)
    run = rows["run"] == rows["run"][0]
    time = rows["time"][run]
    late = injected.CHANGES["channel_delay"][0](rows, 0.05, NOTHING)["fy"][run]
    assert late == pytest.approx(np.interp(time - 0.05, time, rows["fy"][run]))
    zero = injected.CHANGES["force_offset"][0](rows, 0.5, NOTHING)["fy"]
    assert zero - rows["fy"] == pytest.approx(0.5)
    heading = injected.CHANGES["slip_offset"][0](rows, 0.02, NOTHING)["alpha"]
    assert heading - rows["alpha"] == pytest.approx(0.02)
    step = injected.CHANGES["friction_step"][0](rows, 0.3, np.random.default_rng(0))
    moved = np.abs(step["fy"] - rows["fy"])
    # At full sliding the force is mu F_z: never more than 30 % of it is added.
    assert moved.max() <= 0.3 * injected.MU * rows["fz"].max() + 1e-9
    assert moved.max() > 0.1
    assert np.all(moved[: len(moved) // 5] == 0)


def test_nothing_here_imports_tirefit():
    for path in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            assert not any(name.split(".")[0] in ("tirefit", "jax") for name in names)
