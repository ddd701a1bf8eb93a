"""Readable data that probably mean something else give a warning with a remedy."""

import numpy as np
import pytest

from tirefit.data.inspect import inspect
from tirefit.data.read import read, read_frame
from tirefit.results import DataError

RNG = np.random.default_rng(17)
LOAD = 4000.0
KAPPA = np.concatenate([np.linspace(-0.2, 0.3, 60), [0.5, 0.8]])


def force(kappa):
    """A tire that slides beyond kappa = 0.1, braking positive."""
    return LOAD * np.tanh(12 * kappa / (1 - kappa))


def frame(kappa, sign=1, header="kappa", **others):
    columns = {header: sign * kappa, "fx": sign * force(kappa)}
    return columns | {"fz": np.full(len(kappa), LOAD)} | others


def speeds(kappa, noise=0.0):
    """omega and v of a wheel of radius 0.3 m that slips by kappa, braking positive."""
    v = RNG.uniform(8, 20, len(kappa))
    omega = v * (1 - kappa) / 0.3
    return {"omega": omega * (1 + noise * RNG.standard_normal(len(v))), "v": v}


def warned(columns, **options):
    return read_frame(columns, **options).source.warnings


def test_undeclared_slips_of_both_signs_are_doubted():
    (text,) = warned(frame(KAPPA))
    assert text.startswith("no convention declared: read as braking, so positive")
    assert "'kappa' (-0.2 to 0.8) is taken as braking" in text
    assert "if positive slip means driving in this file" in text
    assert "pass --convention iso-w or adapted-sae" in text
    assert "--convention braking" in text


@pytest.mark.parametrize("convention", ["braking", "iso-w", "adapted-sae"])
def test_a_declared_convention_is_not_doubted(convention):
    sign = 1 if convention == "braking" else -1
    assert warned(frame(KAPPA, sign), convention=convention) == ()


@pytest.mark.parametrize(
    "kappa",
    [np.linspace(*ends, 50) for ends in ((0, 0.4), (-8e-3, 0.4), (-2e-3, 2e-3))],
    ids=["braking", "braking with noise about zero", "hardly any slip"],
)
def test_braking_slips_are_not_doubted(kappa):
    assert warned(frame(kappa)) == ()


def test_a_braking_test_in_driving_positive_signs_is_doubted():
    # All slips and forces negative: as plausible a braking test as a driving one.
    (text,) = warned(frame(np.linspace(0, 0.4, 50), sign=-1))
    assert "'kappa' (-0.4 to 0) is taken as braking" in text


@pytest.mark.parametrize(("equal", "conventions"), [(1, "adapted-sae;"), (-1, "iso-w;")])
def test_lateral_signs_restrict_the_conventions(equal, conventions):
    alpha = np.linspace(-0.1, 0.1, len(KAPPA))
    columns = frame(KAPPA) | {"alpha": alpha, "fy": equal * 3e4 * alpha}
    if equal > 0:
        (text,) = warned(columns)
        assert f"pass --convention {conventions}" in text
    else:  # what check_signs refuses, with the same remedy
        said = f"fit convention='{conventions.rstrip(';')}'"
        with pytest.raises(DataError, match=said):
            read_frame(columns)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_wheel_and_vehicle_speed_determine_the_sign(noise):
    turning = speeds(KAPPA, noise)
    assert warned(frame(KAPPA, **turning)) == ()
    (text,) = warned(frame(KAPPA, sign=-1, **turning))
    assert "is taken as braking, but omega / v rises with it" in text
    positive = np.linspace(0.01, 0.3, 40)  # driven wheels: slips of one sign
    (text,) = warned(frame(-positive, sign=-1, **speeds(-positive, noise)))
    assert "is taken as braking, but omega / v rises with it" in text
    (text,) = warned(frame(KAPPA, **turning), convention="iso-w")
    assert (
        "slower than a freely rolling one (omega / v), but not" in text
        and "signs of 'iso-w'" in text
    )
    assert warned(frame(KAPPA, sign=-1, **turning), convention="iso-w") == ()


def test_uninformative_speeds_do_not_determine_the_sign():
    columns = frame(KAPPA, omega=RNG.uniform(30, 60, len(KAPPA)), v=np.full(62, 15.0))
    (text,) = warned(columns)
    assert "omega" not in text
    columns = frame(KAPPA, omega=np.zeros(62), v=np.zeros(62))
    assert len(warned(columns)) == 1


def test_a_slip_computed_from_the_speeds_is_not_doubted():
    columns = {"fx": force(KAPPA), "fz": np.full(62, LOAD), **speeds(KAPPA)}
    assert warned(columns, rolling_radius=0.3) == ()


LOGGED_WRONG = {
    "speeds of another wheel": (
        lambda kappa: kappa,
        {"omega": 40.0, "v": 12.0},
        "check the rolling radius",
    ),
    "mirrored": (lambda kappa: -kappa, {}, "the opposite sign: declare the file's"),
    "twice": (lambda kappa: 2 * kappa, {}, "it agrees if divided by 2:"),
}


@pytest.mark.parametrize(("logged", "others", "said"), LOGGED_WRONG.values(), ids=LOGGED_WRONG)
def test_a_slip_that_contradicts_the_speeds_is_reported(logged, others, said):
    kappa = np.linspace(-0.2, 0.3, 60)
    turning = speeds(kappa) | {k: np.full(60, x) for k, x in others.items()}
    columns = frame(kappa, **turning) | {"kappa": logged(kappa)}
    # The force follows the logged slip, so its signs alone do not contradict.
    columns["fx"] = force(columns["kappa"])
    source = read_frame(columns, rolling_radius=0.3, **BRAKING).source
    check = source.slip_check
    rolled = _bounded(1 - turning["omega"] * 0.3 / turning["v"])
    assert check.contradicts and check.radius == 0.3
    apart = np.median(abs(_bounded(logged(kappa)) - rolled))
    assert check.difference == pytest.approx(apart, rel=1e-6) and apart > 0.04
    text = next(text for text in source.warnings if "contradicts (v" in text)
    assert text == f"column 'kappa': {check.text}" and said in text
    assert f": by {apart:.3g} in the median" in text


def test_a_slip_by_another_rolling_radius_is_reported_with_it():
    turning = speeds(KAPPA)
    sigma = turning["v"] / (turning["omega"] * 0.33) - 1
    columns = frame(sigma, header="sigma_x", **turning)
    columns["fx"] = LOAD * np.tanh(12 * sigma)
    (text,) = warned(columns, rolling_radius=0.3, **BRAKING)
    assert text.endswith("a rolling radius of 0.33 m would give it, not 0.3 m")


def _bounded(kappa):
    """The slip ratio of a kappa: kappa in braking, sigma in driving."""
    return np.where(kappa > 0, kappa, kappa / (1 - kappa))


BRAKING = {"convention": "braking"}


# --- time ---------------------------------------------------------------------


@pytest.mark.parametrize("last", [0.05, 0.3])
def test_decreasing_time_is_reported_with_place_and_remedy(tmp_path, last):
    time, kappa = [0.0, 0.1, 0.0, 0.2, last, 0.1], np.linspace(0.01, 0.2, 6)
    rows = zip(time, kappa, force(kappa), "aabaab", strict=True)
    path = tmp_path / "a.csv"
    lines = [f"{t},{k},{f},4000,{run}" for t, k, f, run in rows]
    path.write_text("\n".join(["Time,kappa,fx,fz,run", *lines, ""]))
    said = read(path, **BRAKING).source.warnings
    # Another run may begin at zero again.
    assert bool(said) == (last < 0.2)
    for text in said:
        assert text.startswith("row 6, column 'Time': the time goes back, from 0.2 s to 0.05 s")
        assert "its own run (--column run=HEADER), or correct the time" in text


# --- units --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factors", "remedy"),
    [
        (
            {"fx": 1e-3},
            "'fx' reaches only 0.001 of the load, too little at these slips: check the units of fx"
            " and fz; if 'fx' is in kN, pass --unit fx=kN",
        ),
        (
            {"fz": 1e-3},
            "'fx' reaches 1000 times the load, which no tire has: check the units of fx and fz;"
            " if 'fz' is in kN, pass --unit fz=kN",
        ),
        ({"fz": 1e-1}, "'fx' reaches 10 times the load, which no tire has"),
        ({"fx": 1e-6}, ": check the units of fx and fz"),
        ({"fx": 1e3}, ": check the units of fx and fz"),
    ],
)
def test_implausible_forces_are_reported_with_a_plausible_unit(factors, remedy):
    columns = frame(KAPPA)
    columns |= {name: columns[name] * factor for name, factor in factors.items()}
    (text,) = warned(columns, **BRAKING)
    assert remedy in text
    if "--unit" in remedy:  # which then is the whole remedy
        (name,) = factors
        assert warned(columns, units={name: "kN"}, **BRAKING) == ()


@pytest.mark.parametrize(
    ("slip", "unit", "larger"),
    [("alpha", "deg", "rad"), ("alpha", "-deg", "-rad"), ("kappa", "%", "-")],
)
@pytest.mark.parametrize("largest", [0.02, 0.15, 0.4])
def test_a_slip_in_a_larger_unit_than_it_is_read_in_is_reported(slip, unit, larger, largest):
    """From slips far below the peak to slips far above it."""
    size = np.linspace(-largest, largest, 50)
    signed = -size if unit[0] == "-" else size
    columns = {slip: signed, {"alpha": "fy", "kappa": "fx"}[slip]: force(size)}
    columns["fz"] = np.full(50, LOAD)
    (text,) = warned(columns, units={slip: unit}, **BRAKING)
    assert text.startswith(f"'{slip}', read in {unit}, is too small for")
    assert text.endswith(f"if it is in {larger}, pass --unit {slip}={larger}")
    assert warned(columns, units={slip: larger}, **BRAKING) == ()


def test_slips_about_zero_are_not_too_small_for_noise():
    alpha, noise = 1e-4 * RNG.standard_normal((2, 500))
    columns = {"alpha": alpha, "fy": 1e6 * (alpha + 3 * noise), "fz": np.full(500, LOAD)}
    assert np.percentile(abs(columns["fy"]) / LOAD, 99) > 100 * np.percentile(abs(alpha), 99)
    assert warned(columns, **BRAKING) == ()


def test_one_of_two_forces_in_kilonewton_is_found():
    alpha = np.linspace(-0.1, 0.1, len(KAPPA))
    columns = frame(KAPPA) | {"alpha": alpha, "Fy": 30 * alpha}
    (text,) = warned(columns, **BRAKING)
    assert "'Fy' reaches only 0.00075 of the load" in text and "--unit fy=kN" in text


def test_a_constant_load_in_kilonewton_is_found():
    columns = frame(KAPPA)
    del columns["fz"]
    (text,) = warned(columns, constants={"fz": 4.0}, **BRAKING)
    assert "give --constant fz in N, not in kN" in text


@pytest.mark.parametrize("largest", [1e-4, 5e-3])
def test_low_utilisation_is_not_reported_as_a_wrong_unit(largest):
    kappa = np.linspace(-largest, largest, 50)
    columns = frame(kappa) | {"fx": 0.4 * force(kappa)}
    assert warned(columns, **BRAKING) == ()


def test_a_few_outliers_are_not_reported_as_a_wrong_unit():
    columns = frame(np.linspace(-0.2, 0.3, 500))
    columns["fx"][:3] *= 100
    assert warned(columns, **BRAKING) == ()


def test_a_side_force_at_zero_slip_angle_is_not_reported_as_a_wrong_unit():
    noise = RNG.standard_normal(62)
    columns = frame(KAPPA) | {"alpha": 1e-4 * noise, "fy": noise}
    assert warned(columns, **BRAKING) == ()


# --- where warnings go ----------------------------------------------------------


def test_warnings_are_in_the_inspection_and_in_the_notes():
    data = read_frame(frame(KAPPA) | {"fx": force(KAPPA) / 1000})
    report = inspect(data)
    assert report.warnings == data.source.warnings and len(report.warnings) == 2
    text = " ".join(report.summary().split())
    assert "warnings no convention declared" in text and "--unit fx=kN" in text
    assert report.to_dict()["warnings"] == list(report.warnings)
    first, second, *rest = data.source.notes
    assert first.startswith("warning: no convention") and "fx=kN" in second
    assert tuple(rest) == data.source.assumptions
    quiet = inspect(read_frame(frame(KAPPA), **BRAKING))
    assert quiet.warnings == () and "warnings" not in quiet.summary()


# --- percent, zeros, masked rows ------------------------------------------------


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("largest", [0.03, 0.2])
def test_slip_in_percent_gets_its_remedy(largest, sign):
    sigma = np.linspace(-largest, largest, 41)
    columns = frame(sigma, sign, header="sigma_x")
    columns["sigma_x"] = columns["sigma_x"] * 100
    with pytest.raises(DataError) as caught:
        read_frame(columns)
    message = "\n".join(map(str, caught.value.problems))
    assert "--unit sigma_x=%" in message and "signs" not in message
    mended = read_frame(columns, units={"sigma_x": "%"})
    np.testing.assert_allclose(mended["sigma_x"], sign * sigma)


def test_a_mirrored_slip_is_reported_with_its_convention():
    sigma = np.linspace(-0.5, 3, 50)  # hard braking, file driving positive
    columns = {"sigma_x": -sigma, "fx": -force(sigma / (1 + sigma)), "fz": np.full(50, LOAD)}
    with pytest.raises(DataError) as caught:
        read_frame(columns)
    message = "\n".join(map(str, caught.value.problems))
    assert "if driving slip is positive: --convention iso-w" in message


def test_a_force_column_of_zeros_is_ignored():
    columns = frame(KAPPA) | {"alpha": KAPPA / 10, "fy": np.zeros(62)}
    data = read_frame(columns, **BRAKING)
    assert "fy" not in data and "fx" in data
    said = "column 'fy' not used: it is zero in all rows"
    assert said in data.source.assumptions
    with pytest.raises(DataError, match="no force: .*; 'F' is zero in all rows"):
        read_frame(
            {"kappa": KAPPA, "F": 0 * KAPPA, "fz": 0 * KAPPA + LOAD}, columns={"fx": "F"}, **BRAKING
        )
    assert "fy" in read_frame(columns, forces=False, **BRAKING)


def test_masked_rows_do_not_suggest_masking():
    columns = frame(KAPPA)
    columns["kappa"][3], columns["fz"][5] = 2.0, -1.0
    with pytest.raises(DataError, match="mask bad rows with mask_bad_rows=True"):
        read_frame(columns)
    masked = read_frame(columns, mask_bad_rows=True).source.masked
    assert [problem.row for problem in masked] == [3, 5]
    assert all("correct the row" in problem.remedy for problem in masked)
    assert "--mask-bad-rows" not in "".join(map(str, masked))


def test_masked_rows_beside_another_problem_do_not_suggest_masking(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("sigma_x,fx,fz\n0.01,100,x\n0.02,200,4000\n")
    with pytest.raises(DataError) as caught:
        read(path, mask_bad_rows=True)
    slips, row = caught.value.problems
    assert "constant slip" in slips.reason and "'x' is text" in row.reason
    assert row.remedy == "correct the row"
