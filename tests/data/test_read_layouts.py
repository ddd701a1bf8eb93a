"""Typical files of rigs: white space, units below the header, lines before it."""

import numpy as np
import pytest
from rig_file import IMPERIAL_UNITS, METRIC_UNITS, truth, ttc
from test_read_kinds import said

from tirefit.data.read import read, read_frame
from tirefit.results import DataError

TITLE = 'Source_File_Name="B9999run7.SI"; Tire_Name="no such tire 16x7.5-10"'


def written(tmp_path, lines, name="run.dat"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n")
    return path


def rows(frame, between="\t"):
    table = zip(*frame.values(), strict=True)
    return [between.join(f"{value:.10g}" for value in row) for row in table]


def same(data, columns):
    for name, values in columns.items():
        np.testing.assert_allclose(data[name], values, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("between", ["\t", "   ", " \t "])
@pytest.mark.parametrize("imperial", [False, True])
def test_a_tire_test_consortium_file_is_recognised_by_its_layout(
    tmp_path, imperial, between, stated
):
    columns = truth()
    frame = ttc(columns, imperial)
    units = IMPERIAL_UNITS if imperial else METRIC_UNITS
    lines = [TITLE, between.join(frame)]
    lines += [between.join(units)] if stated else []
    data = read(written(tmp_path, [*lines, *rows(frame, between)]))
    same(data, columns)
    assert data.source.convention == "sae"
    assert said(data, "signs read as 'sae', as FZ is negative")
    assert said(data, "columns not read: 'RL', 'RE'")
    assert said(data, "imperial units") == (imperial and not stated)
    assert not data.source.warnings
    assert data.source.line[0] == len(lines) + 1


def test_a_declaration_overrides_the_layout():
    frame = ttc(truth())
    with pytest.raises(DataError, match="z down.*convention='sae'"):
        read_frame(frame, convention="iso-w")


@pytest.mark.parametrize(("fy", "convention"), [(1, "adapted-sae"), (-1, "iso-w")])
def test_a_converted_consortium_file_has_the_signs_of_iso_or_is_declared(fy, convention):
    columns = truth()
    frame = ttc(columns)
    turned = {"SA": -frame["SA"], "FZ": -frame["FZ"], "FY": fy * frame["FY"]}
    turned["MZ"] = fy * frame["MZ"]
    if fy > 0:
        with pytest.raises(DataError, match="these signs fit convention='braking' or adapted-sae"):
            read_frame(frame | turned)
    data = read_frame(frame | turned, **({"convention": convention} if fy > 0 else {}))
    assert data.source.convention == convention
    same(data, columns)


def test_the_slip_of_a_driving_test_is_the_one_that_is_zero_at_zero_force():
    columns = truth()
    kappa = 0.1 * np.sin(np.arange(120) / 9)
    frame = ttc(columns) | {"SL": -kappa, "SR": -kappa + 0.03}
    frame["FX"] = -2e4 * kappa
    data = read_frame(frame)
    np.testing.assert_allclose(data["sigma_x"], kappa / (1 - kappa))
    np.testing.assert_allclose(data["fx"], 2e4 * kappa)
    assert said(data, "'SR' uses another radius")
    declared = read_frame(frame, columns={"kappa": "SR"})
    np.testing.assert_allclose(declared["sigma_x"], (kappa - 0.03) / (1.03 - kappa))


KAPPA = np.array([-0.08, -0.04, -0.01, 0.01, 0.03, 0.06, 0.1])
NUMBERS = [f"{k}   {40000 * k:.1f} 4000.5" for k in KAPPA]


@pytest.mark.parametrize(
    "lines",
    [
        ["kappa fx fz", *NUMBERS],
        ["kappa fx   fz", "-    kN  N", *NUMBERS],
        ["  kappa\tfx\tfz", *["   " + row for row in NUMBERS]],
        ["Speed and slip", "kappa fx fz", *NUMBERS],
        ["A test of a tire", "made on a rig", "", "kappa fx fz", "", *NUMBERS],
        [f"key{i}: {i}" for i in range(40)] + ["kappa fx fz", *NUMBERS],
        ["practical slip  long. force  wheel load", *NUMBERS],
        ['"kappa" "fx" "fz"', *NUMBERS],
        ["# made by a script", "# kappa fx fz", *NUMBERS],
        ["% kappa fx fz", "", *NUMBERS],
        ["kappa fx fz", *(row.replace(".", ",") for row in NUMBERS)],
    ],
)
def test_white_space_separates_columns(tmp_path, lines):
    options = {}
    if "practical" in lines[0]:
        options["columns"] = {"fx": "long. force"}
    data = read(written(tmp_path, lines), **options)
    kilo = 1000 if "kN" in lines[1] else 1
    np.testing.assert_array_equal(data["sigma_x"], KAPPA / (1 - KAPPA))
    np.testing.assert_allclose(data["fx"], kilo * np.round(40000 * KAPPA, 1))
    np.testing.assert_array_equal(data["fz"], 4000.5)
    assert said(data, "columns separated by white space")
    assert data.source.line[-1] == len(lines)


@pytest.mark.parametrize("between", [",", "; ", "\t"])
def test_a_header_in_a_comment_is_read(tmp_path, between):
    columns = np.stack([KAPPA, 4e4 * KAPPA, np.full(7, 4e3)], axis=1)
    path = tmp_path / "a.csv"
    names = between.join(["kappa", "fx", "fz"])
    np.savetxt(path, columns, delimiter=between, header=f"a test\n{names}")
    data = read(path)
    np.testing.assert_allclose(data["fx"], 4e4 * KAPPA)
    assert said(data, "header read from the comment in line 2")
    path.write_text(path.read_text().replace("kappa", "Schlupf").replace("f", "K"))
    with pytest.raises(DataError, match="numbers, not column names"):
        read(path)


def test_a_title_with_known_words_is_not_taken_for_a_header(tmp_path):
    lines = ["slip force load", "kappa,fx,fz", *(r.replace(" ", ",") for r in NUMBERS)]
    lines = [line.replace(",,,", ",") for line in lines]
    assert read(written(tmp_path, lines)).n == len(KAPPA)


def test_unknown_column_names_must_be_declared(tmp_path):
    path = written(tmp_path, ["Schlupf Kraft Last", *NUMBERS])
    with pytest.raises(DataError, match="columns found: 'Schlupf', 'Kraft', 'Last'"):
        read(path)
    names = {"kappa": "Schlupf", "fx": "Kraft", "fz": "Last"}
    assert read(path, columns=names).n == len(KAPPA)


def test_a_title_of_several_cells_over_unknown_words_is_no_header(tmp_path):
    title = ["Bench 7;Tire XY", "Date;12.03.2024"]
    rows = [row.replace(".", ",").split() for row in NUMBERS]
    lines = [*title, "Schlupf;Kraft;Last", *(";".join(row) for row in rows)]
    path = written(tmp_path, lines)
    with pytest.raises(DataError, match="columns found: 'Schlupf', 'Kraft', 'Last'"):
        read(path)


# --- AiM RaceStudio ---------------------------------------------------------------


AIM_NAMES = ("Time", "Slip Ratio", "Long Force", "Load", "Fuel")
AIM_UNITS = dict(zip(AIM_NAMES, ("s", "%", "kN", "N", "l"), strict=True))


def aim(rows, *, mark=",", quoted=True, numbered=True, comma=False, gap=2):
    """Lines of an export of RaceStudio: keys and values, names, units, numbers."""
    head = [
        ["Format", "AiM CSV File"],
        ["Venue", "Drum"],
        ["Comment", "kappa, fx"],
        ["Date", "Monday, May 5, 2025"],
        ["Time", "10:00 AM"],
        ["Sample Rate", "20"],
        ["Segment Times", "0:01.0", "0:01.5"],
        *[[]] * gap,
        list(AIM_UNITS),
        list(AIM_UNITS.values()),
    ]
    head += [[str(k + 1) for k in range(len(AIM_UNITS))]] if numbered else []
    body = [[f"{x:.6g}" for x in row] for row in rows]
    if comma:
        body = [[cell.replace(".", ",") for cell in row] for row in body]
    cell = '"{}"'.format if quoted or mark == "," else str
    return [mark.join(map(cell, row)) for row in [*head, *[[]] * gap, *body]]


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"mark": ";"},
        {"mark": ";", "quoted": False},
        {"numbered": False},
        {"mark": ";", "comma": True},
        {"gap": 0},
        {"mark": "\t", "gap": 1},
    ],
    ids=str,
)
def test_an_aim_export_is_read(tmp_path, how):
    slip = np.linspace(-5, 20, 50)
    rows = [(k / 20, x, np.tanh(x / 8), 4000, 1.5) for k, x in enumerate(slip)]
    path, twin = tmp_path / "aim.csv", tmp_path / "twin.csv"
    path.write_text("\r\n".join(aim(rows, **how)) + "\r\n", newline="")
    names = [f"{name} [{unit}]" for name, unit in AIM_UNITS.items()]
    lines = [",".join(f"{x:.6g}" for x in row) for row in rows]
    twin.write_text("\n".join([",".join(names), *lines]) + "\n")
    one, other = (read(file, slip="kappa") for file in (path, twin))
    assert one.n == other.n == len(rows)
    for name in ("time", "sigma_x", "fx", "fz"):
        np.testing.assert_array_equal(one[name], other[name])
    assert said(one, "export of AiM")


def test_a_large_aim_export_is_read_exactly(tmp_path):
    rows = [(k / 20, 5 * np.sin(k), np.cos(k), 4000, 1.5) for k in range(60_000)]
    path = tmp_path / "aim.csv"
    path.write_text("\n".join(aim(rows)) + "\n")
    data = read(path, slip="kappa")
    assert data.n == len(rows)
    np.testing.assert_allclose(data["fx"], 1e3 * np.cos(range(60_000)), atol=1e-2)


def test_damaged_rows_of_an_aim_export_are_named(tmp_path):
    rows = [(k / 20, k - 5, np.tanh(k / 8), 4000, 1.5) for k in range(30)]
    lines = aim(rows)
    lines[-3] = lines[-3].replace('"4000"', '"#####"')
    path = tmp_path / "aim.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(DataError) as caught:
        read(path, slip="kappa")
    assert f"row {len(lines) - 2}, column 'Load': '#####'" in str(caught.value)
