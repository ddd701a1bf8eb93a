"""Data are read with units, conventions, encodings and slips made canonical."""

import gzip
import hashlib

import numpy as np
import pytest

from tirefit import slip
from tirefit.data import check
from tirefit.data.columns import guess, is_number
from tirefit.data.read import read, read_frame
from tirefit.data.readers import text
from tirefit.data.units import known_unit, resolve_unit
from tirefit.data.write import to_convention
from tirefit.results import DataError

RNG = np.random.default_rng(7)
KAPPA = np.array([-0.08, -0.04, -0.01, 0.01, 0.03, 0.06, 0.1])
FX = 40000 * KAPPA
TEXT = "kappa;fx;fz\n" + "".join(f"{k};{f:.1f};4000.5\n" for k, f in zip(KAPPA, FX, strict=True))


def write(tmp_path, content, name="test.csv"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def said(data, fragment):
    return any(fragment in sentence for sentence in data.source.assumptions)


@pytest.mark.parametrize(
    ("content", "name", "fragment"),
    [
        (TEXT.encode(), "a.csv", ""),
        (TEXT.replace(";", ",").encode(), "a.csv", ""),
        (TEXT.replace(";", "\t").encode(), "a.tsv", ""),
        (TEXT.replace(";", " | ").encode(), "a.txt", ""),
        (TEXT.replace("\n", "\r\n").encode(), "a.csv", ""),
        (TEXT.encode("utf-8-sig"), "a.csv", ""),
        (TEXT.encode("utf-16"), "a.csv", "UTF-16"),
        (TEXT.replace(".", ",").encode(), "a.csv", "decimal comma"),
        (gzip.compress(TEXT.encode(), mtime=0), "a.csv.gz", ""),
        (b'# a comment; "\n\n' + TEXT.encode().replace(b"\n", b"\n\n"), "a.csv", ""),
        (TEXT.replace("fz\n", "fz\n-;N;N\n").encode(), "a.csv", "row 2 read as units"),
        (
            TEXT.replace("fz", "fz;Stra\xdfe").replace(".5\n", ".5;1\n").encode("latin-1"),
            "a.csv",
            "Latin-1",
        ),
        (b"A test of a tire\n" + TEXT.encode(), "a.csv", "before the header in line 2"),
        (TEXT.replace(".5\n", ".5;\n").encode(), "a.csv", ""),
        (TEXT.replace("\n", ";\n").encode(), "a.csv", ""),
        (TEXT.replace("\n", "\r").encode(), "a.csv", ""),
        (TEXT.replace("-", "\N{MINUS SIGN}").encode(), "a.csv", ""),
        (TEXT.replace(";", "\xa0;\xa0").encode(), "a.csv", ""),
        (TEXT.replace("4000.5", "4.0005E+03").encode(), "a.csv", ""),
        (b"# joined\n\xef\xbb\xbf" + TEXT.encode(), "a.csv", ""),
        (TEXT.replace("fx", "\ufefffx").encode(), "a.csv", ""),
        (TEXT.encode() + b"\x1a", "a.csv", ""),
        (gzip.compress(TEXT.encode(), mtime=0), "a.csv", ""),
        (TEXT.encode(), "a.csv.gz", ""),
        (b"sep=;\n" + TEXT.encode(), "a.csv", "before the header in line 2"),
        (
            TEXT.replace("fz\n", "fz;x;x\n").replace(".5\n", ".5;1;\n").encode(),
            "a.csv",
            "columns not read: 'x', 'x'",
        ),
        (TEXT.replace("fz\n", "fz\n\n[-];[N];[N]\n").encode(), "a.csv", "row 3 read as units"),
    ],
)
def test_every_text_format_gives_the_same_numbers(tmp_path, content, name, fragment):
    path = write(tmp_path, content, name)
    data = read(path)
    np.testing.assert_array_equal(data["sigma_x"], KAPPA / (1 - KAPPA))
    np.testing.assert_allclose(data["fx"], FX, rtol=1e-14)
    np.testing.assert_array_equal(data["fz"], 4000.5)
    assert data.runs == ("a",)
    assert data.source.sha256 == hashlib.sha256(content).hexdigest()
    assert said(data, fragment)
    assert said(data, "column 'fx' read as fx in N")
    assert said(data, "no sign convention declared: 'braking' assumed")


def test_a_units_row_is_used(tmp_path):
    content = TEXT.replace("fz\n", "fz\n%;kN;daN\n")
    data = read(write(tmp_path, content))
    np.testing.assert_allclose(data["fx"], 1000 * FX)
    np.testing.assert_allclose(data["fz"], 40005)
    np.testing.assert_allclose(data["sigma_x"], KAPPA / (100 - KAPPA))
    assert data.source.line[0] == 3


@pytest.mark.parametrize(
    ("header", "delimiter"),
    [
        ('"kappa, -","Fx, N","Fz, N"', ","),
        ('"kappa, -";"Fx, N";"Fz, N"', ";"),
        ("kappa, -, -;Fx, N;Fz, N", ";"),
        ('"kappa\r\n[-]","Fx\n[N]",Fz', ","),
        ('"A title"\n"kappa\n[-]","Fx\n[N]",Fz', ","),
        ("'Title, of a test'\nkappa|Fx, N|Fz, N", "|"),
    ],
)
def test_headers_may_hold_delimiters_and_line_ends(tmp_path, header, delimiter):
    rows = TEXT.split("\n", 1)[1].replace(";", delimiter)
    data = read(write(tmp_path, f"{header}\n{rows}"))
    np.testing.assert_array_equal(data["sigma_x"], KAPPA / (1 - KAPPA))
    np.testing.assert_array_equal(data["fz"], 4000.5)
    assert data.source.line[0] == header.count("\n") + 2
    assert "\n" not in "".join(data.source.columns.values())


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Fx [kN]", "fx", "kN"), ("slip (%)", "kappa", "%"),
        ("alpha_deg", "alpha", "deg"), ("Fz_N", "fz", "N"), ("v_kmh", "v", "kmh"),
        ("mz_Nm", "mz", "Nm"), ("vx_mmps", "v", "mmps"), ("Fx_std_N", "fx_std", "N"),
        ("slip ratio", "slip_ratio", None), ("SR", "kappa", None),
        ("SA", "alpha", None), ("IA", "gamma", None), ("lambda", "kappa", None),
        ("Slip_Angle", "alpha", None), ("load / kN", "fz", "kN"),
        ("speed, km/h", "v", "km/h"), ("t [s]", "time", "s"), ("s", "s", None),
        ("elapsed", "time", None), ("σ_x", "sigma_x", None), ("kappa_std", "kappa_std",
        None), ("W (IMU)", None, None), ("vicon time", None, None),
        ("sinkage_std_mm", None, None), ("fx_front", None, None),
        ("kappa_1", None, None), ("vx_cmd_mmps", None, None), ("", None, None),
        ("MX", "mx", None), ("Mx_Nm", "mx", "Nm"), ("overturning moment", "mx", None),
        ("Overturning Couple [ft-lb]", "mx", "ft-lb"), ("My (Nm)", "my", "Nm"),
        ("rolling resistance", "my", None), ("mx std", "mx_std", None),
        ("mx [uT]", None, None), ("Rolling resistance [N]", None, None),
    ],
)  # fmt: skip
def test_headers_are_recognised_or_ignored(header, name, unit):
    guessed = guess(header)
    assert (guessed and tuple(guessed)) == ((name, unit) if name else None)


@pytest.mark.parametrize(
    ("column", "unit", "value", "si"),
    [
        ("kappa", "%", 5, 0.05), ("alpha", "deg", 180, np.pi), ("alpha", "°", 90,
        np.pi / 2), ("fx", "kN", 2, 2000), ("fz", "lbf", 1, 4.4482216152605),
        ("fz", "kgf", 1, 9.80665), ("v", "km/h", 36, 10), ("v", "mph", 1, 0.44704),
        ("v", "mm/s", 1, 1e-3), ("omega", "rpm", 60, 2 * np.pi),
        ("pressure", "bar", 2, 2e5), ("pressure", "psi", 1, 6894.757293168361),
        ("temperature", "K", 273.15, 0), ("temperature", "degF", 212, 100),
        ("time", "ms", 5, 0.005), ("mz", "N m", 3, 3), ("mz", "N·mm", 1, 1e-3),
        ("fx", "-kN", 2, -2000), ("fx", "KN", 2, 2000), ("sigma_x", "-", 0.3, 0.3),
        ("fx", "dyne", 1, 1e-5), ("v", "knots", 1, 1852 / 3600), ("fx", "mN", 1, 1e-3),
        ("fx", "MN", 1, 1e6), ("alpha", "arcminute", 60, np.pi / 180),
        ("pressure", "inHg", 1, 3386.389), ("yaw_rate", "degree/second", 180, np.pi),
        ("mz", "lbf*in", 1, 0.1129848290), ("a_x", "m/s**2", 1, 1), ("fz", "newton", 1, 1),
    ],
)  # fmt: skip
def test_units_convert_in_both_directions(column, unit, value, si):
    found = resolve_unit(unit, column)
    assert found.to_si(value) == pytest.approx(si, rel=1e-6, abs=1e-12)
    assert found.from_si(found.to_si(value)) == pytest.approx(value, rel=1e-12)


def test_a_std_column_has_neither_sign_nor_offset():
    assert resolve_unit("degF", "temperature_std").to_si(9, True) == pytest.approx(5)
    assert resolve_unit("-kN", "fx_std").to_si(2, True) == 2000


def test_milli_is_not_read_as_mega():
    assert known_unit("mPa") is None and known_unit("mn") is None
    assert resolve_unit("MPa", "pressure").to_si(1) == 1e6


@pytest.mark.parametrize(
    ("convention", "signs"),
    [
        ("braking", (1, 1, 1, 1, 1, 1)),
        ("iso-w", (-1, 1, -1, -1, 1, -1)),
        ("sae", (-1, -1, -1, 1, -1, 1)),
        ("adapted-sae", (-1, 1, -1, 1, 1, 1)),
    ],
)
def test_every_convention_is_converted_to_the_canonical_one(convention, signs):
    canonical = (KAPPA, KAPPA / 2, FX, FX / 3, np.full(7, 4e3), -FX / 90)
    names = ("kappa", "alpha", "fx", "fy", "fz", "mz")
    frame = {
        name: sign * values for name, sign, values in zip(names, signs, canonical, strict=True)
    }
    data = read_frame(frame, convention=convention)
    np.testing.assert_allclose(data["sigma_x"], slip.sigma_from_kappa(KAPPA))
    for name, values in list(zip(names, canonical, strict=True))[1:]:
        np.testing.assert_array_equal(data[name], values, err_msg=name)
    assert not said(data, "no sign convention")


def test_flipping_a_column_corrects_mixed_signs():
    frame = {"kappa": KAPPA, "fx": -FX, "fz": np.full(7, 4000.0)}
    with pytest.raises(DataError, match="units={'fx': '-N'}"):
        read_frame(frame)
    data = read_frame(frame, units={"fx": "-N"})
    np.testing.assert_array_equal(data["fx"], FX)
    assert said(data, "sign of column 'fx' flipped")


def frame_of(name, values, **others):
    return {name: values, "fx": FX, "fz": np.full(7, 4000.0), **others}


@pytest.mark.parametrize("definition", list(slip.SLIP_DEFINITIONS))
def test_slip_definitions_and_their_std_are_converted_to_sigma(definition):
    sigma = slip.sigma_from_kappa(KAPPA)
    to_sigma, from_sigma = slip.SLIP_DEFINITIONS[definition]
    own = from_sigma(sigma)
    std = {f"{definition}_std": np.full(7, 1e-3)}
    data = read_frame(frame_of(definition, own, **std))
    np.testing.assert_allclose(data["sigma_x"], sigma, rtol=1e-13)
    slope = (to_sigma(own + 1e-6) - to_sigma(own - 1e-6)) / 2e-6
    np.testing.assert_allclose(data["sigma_x_std"], 1e-3 * slope, rtol=1e-6)
    assert data.source.slip_definition == definition
    overridden = read_frame(frame_of("slip", own, slip_std=std.popitem()[1]), slip=definition)
    np.testing.assert_array_equal(overridden["sigma_x"], data["sigma_x"])
    np.testing.assert_array_equal(overridden["sigma_x_std"], data["sigma_x_std"])


@pytest.mark.parametrize("key", list(slip.SLIP_DEFINITIONS))
@pytest.mark.parametrize("definition", list(slip.SLIP_DEFINITIONS))
def test_a_unit_may_name_any_slip_definition(definition, key):
    plain = read_frame(frame_of(definition, KAPPA))
    percent = read_frame(frame_of(definition, 100 * KAPPA), units={key: "%"})
    np.testing.assert_allclose(percent["sigma_x"], plain["sigma_x"], rtol=1e-12)


@pytest.mark.parametrize("n", [1, 3])
def test_prediction_needs_no_force_and_no_sweep(n):
    frame = {"kappa": np.full(n, -5.0), "fz": np.full(n, -4.0), "v": np.full(n, 20.0)}
    units = {"kappa": "%", "fz": "kN", "fx": "-kN", "fx_std": "N"}
    data = read_frame(frame, forces=False, units=units, columns={"fx": "F"}, convention="sae")
    assert list(data.columns) == ["sigma_x", "fz", "v"]
    np.testing.assert_allclose(data["sigma_x"], 0.05 / 0.95)
    np.testing.assert_allclose(data["fz"], 4000)
    assert said(data, "column 'F' (fx) is not there")
    out = to_convention(data, {"fx": np.full(n, 1500.0)})
    np.testing.assert_allclose(out["fx"], 1.5)
    assert read_frame({"alpha": [0.1], "fz": [4e3]}, forces=False).n == 1
    speeds = {"omega": [60.0], "v": [20.0], "fz": [4e3]}
    found = read_frame(speeds, forces=False, rolling_radius=0.3)
    np.testing.assert_allclose(found["sigma_x"], 1 / 9)
    with pytest.raises(DataError, match="no force") as caught:
        read_frame({"kappa": [0.1], "fz": [4e3]})
    assert "no slip" not in "\n".join(map(str, caught.value.problems))


def test_given_forces_are_still_checked_for_prediction():
    frame = {"kappa": KAPPA, "fx": -FX, "fz": np.full(7, 4000.0)}
    with pytest.raises(DataError, match="contradict"):
        read_frame(frame, forces=False)


def test_a_std_without_its_column_is_in_si():
    data = read_frame(frame_of("kappa", KAPPA, noise=np.ones(7)), columns={"fy_std": "noise"})
    np.testing.assert_array_equal(data["fy_std"], 1)


def test_slip_s_uses_the_slip_angle():
    alpha = np.linspace(-0.2, 0.2, 7)
    data = read_frame(frame_of("s", KAPPA * np.cos(alpha), alpha=alpha))
    np.testing.assert_allclose(data["sigma_x"], slip.sigma_from_kappa(KAPPA))
    assert said(data, "kappa = s / cos(alpha)")


def test_locked_and_spinning_wheels_stay_finite():
    ratio = np.array([-1, -0.5, -0.1, 0.1, 0.2, 0.5, 1])
    data = read_frame(frame_of("slip_ratio", ratio))
    assert data["sigma_x"][-1] == slip.LOCKED
    assert data["sigma_x"][0] == -1 + 1e-6
    assert said(data, "1 rows of 'slip_ratio' are a locked wheel")
    assert said(data, "1 rows of 'slip_ratio' spin on the spot")


def test_slip_is_computed_from_or_checked_with_the_wheel_speed():
    radius, v = 0.3, 20.0
    omega = v * (1 - KAPPA) / radius
    speeds = {"omega": omega, "v": np.full(7, v), "fx": FX, "fz": np.full(7, 4e3)}
    data = read_frame(speeds, rolling_radius=radius)
    np.testing.assert_allclose(data["sigma_x"], slip.sigma_from_kappa(KAPPA), rtol=1e-9)
    assert said(data, "with R = 0.3 m")
    agreeing = read_frame({"kappa": KAPPA, **speeds}, rolling_radius=radius * 1.001)
    np.testing.assert_allclose(agreeing["sigma_x"], data["sigma_x"])
    check = agreeing.source.slip_check
    assert not check.contradicts and not check.text
    assert check.radius == pytest.approx(0.3003)
    assert 0 < check.difference <= 1.001e-3
    assert data.source.slip_check is None  # of the speeds alone there is one slip
    speeds["omega"] = np.where(KAPPA == KAPPA[-1], 0, omega)
    assert read_frame(speeds, rolling_radius=radius)["sigma_x"][-1] == slip.LOCKED


def test_declared_columns_units_and_constants_are_used(tmp_path):
    content = "run;Schlupf;Kraft;Tempo\n" + "".join(
        f"{run};{100 * k};{f / 1000};72\n" for run, k, f in zip("aabbbac", KAPPA, FX, strict=True)
    )
    data = read(
        write(tmp_path, content),
        columns={"kappa": "Schlupf", "fx": "kraft", "v": "Tempo"},
        units={"kappa": "%", "fx": "kN", "v": "km/h"},
        constants={"fz": 4000, "fx_std": 20},
    )
    np.testing.assert_allclose(data["fx"], FX)
    np.testing.assert_allclose(data["v"], 20)
    np.testing.assert_array_equal(data["fz"], 4000)
    np.testing.assert_array_equal(data["fx_std"], 20)
    assert data.runs == ("a", "b", "c")
    assert data.run.tolist() == [0, 0, 1, 1, 1, 0, 2]
    assert data.source.columns["sigma_x"] == "Schlupf"
    assert data.source.units["v"] == "km/h"
    assert said(data, "column 'Kraft' read as fx in kN, as declared")
    assert said(data, "fz = 4000 N in all rows")


def test_a_std_column_has_the_unit_of_its_column():
    data = read_frame({**frame_of("kappa", KAPPA), "fx_std": np.full(7, 0.1)}, units={"fx": "kN"})
    np.testing.assert_allclose(data["fx_std"], 100)
    assert said(data, "'fx_std' read as fx_std in kN (the unit of fx)")


def test_unrecognised_columns_are_listed(tmp_path):
    frame = {**frame_of("kappa", KAPPA), "colour": ["red"] * 7, "fy_std": np.ones(7)}
    data = read_frame(frame)
    assert "fy_std" not in data
    assert said(data, "columns not read: 'colour', 'fy_std'")
    assert said(data, "column 'fy_std' not used: there is no fy")


@pytest.mark.parametrize(("n", "correlation"), [(8, -0.7), (5000, -0.15)])
def test_a_weak_trend_is_no_contradiction(n, correlation):
    x, noise = RNG.normal(size=(2, n))
    noise -= x * np.sum(x * noise) / np.sum(x * x)
    noise *= np.sqrt(np.sum(x * x) / np.sum(noise * noise))
    force = correlation * x + np.sqrt(1 - correlation**2) * noise
    frame = {"alpha": 0.05 * x, "fy": 1e3 * force, "fz": np.full(n, 4e3)}
    assert read_frame(frame).n == n
    frame["fy"] = -1e4 * x + noise
    with pytest.raises(DataError, match="contradict"):
        read_frame(frame)


def test_a_header_of_many_columns_is_split(tmp_path):
    more = [f"channel_{i}" for i in range(15_000)]  # more than csv allows in one cell
    header = ",".join(["kappa", "fx", "fz", *more])
    rows = [f"{k},{f},4000" + ",0" * len(more) for k, f in zip(KAPPA, FX, strict=True)]
    data = read(write(tmp_path, "\n".join([header, *rows])))
    np.testing.assert_allclose(data["fx"], FX)


def test_a_large_file_is_not_read_cell_by_cell(tmp_path, monkeypatch):
    looked_at = []

    def counted(cell):
        looked_at.append(cell)
        return is_number(cell)

    for module in (check, text):
        monkeypatch.setattr(module, "is_number", counted)
    n = 20_000
    values = RNG.normal(scale=0.05, size=(n, 5))
    rows = [",".join(map(repr, row)) for row in values.tolist()]
    content = "kappa,alpha,a,b,c,fx,fz\n" + "\n".join(f"{r},1.5,4000" for r in rows)
    path = write(tmp_path, content)
    assert read(path).n == n
    # The header and the row below it are looked at; the rest is converted whole.
    assert len(looked_at) < 100


def test_a_slip_may_be_a_constant():
    table = read_frame(
        {"alpha": [0.01, 0.02, 0.03], "fy": [700.0, 1400.0, 2100.0], "fz": [4e3] * 3},
        constants={"sigma_x": 0.05},
    )
    np.testing.assert_array_equal(table["sigma_x"], 0.05)
    with pytest.raises(DataError, match="--constant sigma_x"):
        read_frame(
            {"alpha": [0.01, 0.02, 0.03], "fy": [700.0, 1400.0, 2100.0], "fz": [4e3] * 3},
            constants={"sigma_x": -3.0},
        )
