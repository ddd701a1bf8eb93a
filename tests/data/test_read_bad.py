"""Every problem of bad input is found, located and explained with a remedy."""

import gzip

import numpy as np
import pytest

from tirefit.data.read import read, read_frame, require
from tirefit.results import DataError, TirefitError, UsageError

HEADER = "kappa,fx,fz\n"
GOOD = "0.01,400,4000\n0.02,800,4000\n0.03,1100,4000\n0.05,1500,4000\n"
WELL = HEADER + GOOD


def lines(*rows):
    return HEADER + GOOD + "\n".join(rows) + "\n"


def table(header, *columns):
    rows = zip(*columns, strict=True)
    return header + "\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n"


SLIP = [-0.08, -0.05, -0.02, 0.02, 0.05, 0.08]
FORCE = [3000, 2000, 900, -900, -2000, -3000]
LOAD = [4000] * 6
UP = [-force for force in FORCE]

CASES = {
    # cells and rows
    "text": (
        lines("0.1,abc,4000"), {}, ["row 6, column 'fx'", "'abc' is text", "mask"]
    ),
    "a date in one row": (
        lines("0.1,2024-01-05,4000"), {},
        ["row 6, column 'fx'", "is a date or a time of day", "mask"],
    ),
    "times of day": (
        table("time,kappa,fx,fz", [f"12:00:0{i}" for i in range(6)], SLIP, UP, LOAD),
        {"mask_bad_rows": True},
        [
            "column 'time': 6 of 6 rows ('12:00:00' in row 2, ...): is a date or a time"
            " of day", "write the seconds since the start", "read_frame",
        ],
    ),
    "no number in a column": (
        table("time,kappa,fx,fz", list("abcdef"), SLIP, UP, LOAD), {},
        ["column 'time': 6 of 6 rows ('a' in row 2, ...): is text", "rename this one"],
    ),
    "empty cell": (
        lines("0.1,,4000"), {}, ["column 'fx'", "1 of 5 rows (20.0%) lack a value (row 6)"]
    ),
    "nan": (lines("nan,1,4000"), {}, ["column 'kappa'", "1 of 5 rows (20.0%)", "(row 6)"]),
    "inf": (lines("0.1,1,-inf"), {}, ["row 6, column 'fz'", "-inf is infinite"]),
    "overflow": (lines("0.1,1e300,1"), {}, ["row 6, column 'fx'", "larger than any"]),
    "underscore": (lines("0.1,1_0,4000"), {}, ["row 6, column 'fx'", "'1_0' is text"]),
    "ragged": (lines("0.1,1"), {}, ["row 6: 2 fields where the header has 3"]),
    "too long": (lines("0.1,1,2,3"), {}, ["row 6: 4 fields where the header has 3"]),
    "comments count": (
        "# a\n\n" + lines("0.1,x,4000"), {}, ["row 8, column 'fx'", "'x'"]
    ),
    "all at once": (
        lines("x,1,4000", "0.1,y,4000", "0.1,1"), {},
        ["row 6, column 'kappa'", "row 7, column 'fx'", "row 8: 2 fields"],
    ),
    "many alike": (
        lines(*["0.01,x,4000"] * 12), {},
        [
            "row 6, column", "row 10, column",
            ", column 'fx': and 7 more rows with the same fault, next in row 11: 'x' is"
            " text where a number is needed",
        ],
    ),
    "many too long": (
        lines(*["0.1,1,2,3"] * 5, "0.1,1", *["0.1,1,2,3"] * 2), {},
        [
            "row 10: 4 fields where the header has 3",
            "and 3 more rows with the same fault, next in row 11: 2 fields where the"
            " header has 3",
        ],
    ),
    "one more": (
        lines(*["0.1,1"] * 6), {},
        ["and 1 more row with the same fault, next in row 11: 2 fields where the"],
    ),
    "unclosed quote": (lines('0.1,"1,4000'), {}, ["row 6: a quotation mark is not"]),
    "quote to the end": (
        HEADER + '0.01,"1,4000\n' + GOOD, {"mask_bad_rows": True},
        ["row 2: a quotation mark is not closed"],
    ),
    "quotes over lines": (
        lines('0.1,"1,4000', '0.2,1",4000', "0.3,x,4000"), {},
        ["row 6, column 'fx': '1,4000", "row 8, column 'fx': 'x' is text"],
    ),
    "ragged over lines": (
        lines('0.1,"1,4000', '0.2"'), {}, ["row 6: 2 fields in rows 6 to 7 where"]
    ),
    "long header": ("x" * 200_000 + "\n1\n", {}, ["row 1", "field larger than"]),
    "long cell": (lines("0.1," + "x" * 200_000), {}, ["row 6", "field larger than"]),
    "long number": (lines(f"0.1,{'1' * 999},4"), {}, ["row 6", f" {'1' * 27}... is"]),
    "unit in the cell": (
        lines("0.1,1 N,4000"), {}, ["row 6, column 'fx': '1 N' is text"]
    ),
    "thousands": (
        lines('0.1,"1,234.5",4000'), {},
        ["row 6, column 'fx': '1,234.5' has a comma", "without group separators"],
    ),
    "thousands or decimals": (
        "kappa;fx;fz\n0;1;4,000\n1;2;4,000\n", {}, ["row 2, column 'fz': '4,000' has"]
    ),
    "thousands beside names of runs": (
        "run;kappa;fx;fz\n" + "dry, lap 1;0;1;4,000\n" * 3, {}, ["column 'fz': '4,000' has"]
    ),
    "points group": (
        "kappa;fx;fz\n0,01;1;4.000,5\n1;2;3\n", {},
        ["row 2, column 'fz': '4.000,5' has a comma"],
    ),
    # range
    "load": (lines("0.1,1,0"), {}, ["row 6, column 'fz'", "0 is not a load"]),
    "kappa": (lines("1.5,1,4000"), {}, ["row 6", "1.5 is out", "--unit kappa=%"]),
    "sigma": (
        lines("7,1,4000").replace("kappa", "sigma_x"), {},
        ["row 6, column 'sigma_x'", "-1 <= sigma_x <= 5", "--unit sigma_x=%"],
    ),
    "below -1": (
        lines("-2,-1,4000").replace("kappa", "sigma_x"), {},
        ["row 6", "-1 <= sigma_x <= 5", "--convention iso-w"],
    ),
    "s": (
        lines("-1.5,-1,4000").replace("kappa", "s"), {},
        ["row 6, column 's'", "|s| <= 1", "--unit s=%"],
    ),
    "s at an angle": (
        table("s,alpha,fx,fz", [0.1, 0.2, 0.9], [0.0, 0.1, 0.6], [1, 2, 3], [9] * 3),
        {}, ["row 4, column 's'", "s / cos(alpha) > 1"],
    ),
    "percent": (
        table("kappa,fx,fz", [1, 2, 3, 4], [1, 2, 3, 4], [9] * 4), {},
        ["3 of 4 rows (2 in row 3, ...)", "column 'kappa'", "--unit kappa=%"],
    ),
    "degrees": (
        table("alpha,fy,fz", [1, 2, 3, 4], [1, 2, 3, 4], [9] * 4), {},
        ["3 of 4 rows", "column 'alpha'", "--unit alpha=deg"],
    ),
    "speed": (
        table("kappa,fx,fz,v", [0, 0.1, 0.2], [0, 1, 2], [9] * 3, [9, -1, 9]), {},
        ["row 3, column 'v'", "-1 is a negative speed"],
    ),
    "pressure": (
        table("kappa,fx,fz,pressure", [0, 0.1, 0.2], [0, 1, 2], [9] * 3, [9, 0, 9]), {},
        ["row 3, column 'pressure'", "0 is not a pressure"],
    ),
    "std": (
        table("kappa,fx,fz,fx_std", [0, 0.1, 0.2], [0, 1, 2], [9] * 3, [1, 0, 1]), {},
        ["row 3, column 'fx_std'", "0 is not a standard deviation"],
    ),
    "z down": (
        table("kappa,fx,fz", SLIP, UP, [-4000] * 6), {},
        ["column 'fz'", "6 of 6 rows (-4000", "(z down): --convention sae"],
    ),
    "z up in sae": (
        table("kappa,fx,fz", SLIP, UP, LOAD), {"convention": "sae"},
        ["column 'fz'", "6 of 6 rows (4000", "positive: --convention braking or iso-w"],
    ),
    # columns
    "no slip": ("fx,fz\n1,2\n", {}, ["no slip", "--column kappa=HEADER", "'fx', 'fz'"]),
    "no radius": (
        "omega,v,fx,fz\n1,2,3,4\n", {}, ["no slip", "--rolling-radius R [m]"]
    ),
    "no force": ("kappa,fz\n0.1,2\n", {}, ["no force", "--column fx=HEADER"]),
    "no load": ("kappa,fx\n0.1,2\n", {}, ["no load", "--constant fz=4000"]),
    "nothing known": (
        "a,b\n1,2\n", {}, ["no slip", "no force", "no load", "columns found: 'a', 'b'"]
    ),
    "two alike": (
        "kappa,Fx [N],force_x,fz\n0.1,1,1,2\n", {},
        ["row 1", "'Fx [N]' and 'force_x' all mean fx", 'columns.fx = "Fx [N]"'],
    ),
    "same header": (
        "kappa,fx,fz,fx\n0.1,1,2,1\n", {},
        ["'fx' and 'fx' all mean fx (columns 2 and 4)", "rename"],
    ),
    "same header, declared": (
        "kappa,F,fz,F\n0.1,1,2,1\n", {"columns": {"fx": "F"}},
        ["the header occurs 2 times (columns 2 and 4)", "rename"],
    ),
    "two slips": (
        "kappa,sigma_x,fx,fz\n0.1,0.1,1,2\n", {},
        ["'kappa' and 'sigma_x'", "all mean kappa and sigma_x", "columns.kappa"],
    ),
    "two definitions": (
        WELL.replace("fz", "fz,sigma_x_std").replace("4000", "4000,0.1"), {},
        ["column 'sigma_x_std'", "but the slip column is kappa"],
    ),
    "spaces": ("kappa fx fz\n1 2\n", {}, ["'kappa fx fz' only; separate columns by"]),
    "no such header": (
        WELL, {"columns": {"fx": "fxx"}}, ["column 'fxx'", "no such", "mean 'fx'"]
    ),
    "declared twice": (
        WELL, {"columns": {"fx": "fx", "fy": "fx"}}, ["declared as fy, but fx"]
    ),
    "constant too": (
        WELL, {"constants": {"fz": 1.0}}, ["column 'fz'", "conflicts", "remove"]
    ),
    "constant angle": (
        WELL, {"constants": {"alpha": 5.0}},
        ["column '--constant alpha'", "out of range"],
    ),
    # units
    "unknown unit": (
        WELL.replace("fx", "fx [kNN]"), {},
        ["row 1, column 'fx [kNN]'", "unknown unit 'kNN'", "mean 'kN'", "--unit fx="],
    ),
    "wrong dimension": (
        WELL.replace("fx", "fx [deg]"), {}, ["unit of angle", "dimension force", "lbf"]
    ),
    "unused unit": (
        WELL, {"units": {"v": "km/h"}}, ["declared by --unit or [data.units] for v"]
    ),
    "unused slip": (
        "alpha,fy,fz\n0,1,2\n0.1,2,2\n", {"slip": "s"},
        ["declared by --slip or [data] slip for s"],
    ),
    "unit of another slip": (
        "alpha,fy,fz\n0,1,2\n0.1,2,2\n", {"units": {"kappa": "%"}},
        ["column 'kappa'", "[data.units] for kappa, which the file does not have"],
    ),
    "angle for a slip": (
        WELL, {"units": {"sigma_x": "deg"}},
        ["column 'kappa'", "unit of angle, but kappa is of dimension ratio"],
    ),
    "two units of a slip": (
        WELL, {"units": {"sigma_x": "%", "s": "-"}},
        ["two units of the slip column", "sigma_x=%, s=-"],
    ),
    # the whole
    "constant slip": (
        table("kappa,fx,fz", [0.1] * 3, [1, 2, 3], [9] * 3), {},
        ["constant slip (sigma_x = 0.111111"],
    ),
    "signs of fx": (
        table("kappa,fx,fz", SLIP, FORCE, LOAD), {},
        ["column 'fx'", "contradict the convention 'braking'", "--unit fx=-N"],
    ),
    "signs of fy": (
        table("alpha,fy,fz", SLIP, FORCE, LOAD), {},
        ["column 'fy'", "the side force rises with the slip angle, but", "--convention iso-w;"],
    ),
    "backwards": (
        table("omega,v,fx,fz", [50, -1, 49], [10, 10, 10], [0, 1, 2], [9] * 3),
        {"rolling_radius": 0.2}, ["row 3, column 'omega'", "turning backwards"],
    ),
    "radius alone": (
        "omega,fx,fz\n1,2,3\n", {"rolling_radius": 0.2}, ["needs v to give a slip"]
    ),
    # the file
    "empty": ("", {}, ["the file is empty"]),
    "only comments": ("# a\n\n", {}, ["the file is empty"]),
    "no rows": (HEADER, {}, ["no data rows"]),
    "no header": (GOOD, {}, ["row 1", "numbers, not column names", "header"]),
    "binary": (b"\x89PNG\r\n\x1a\n\x00\x00", {}, ["not a text file"]),
    "zeros": (b"kappa,fx,fz\n0.1,\x001,2\n", {}, ["row 2: not a text file"]),
    "no byte order mark": (WELL.encode("utf-16-le"), {}, ["UTF-16 without"]),
    "utf-32": (WELL.encode("utf-32"), {}, ["not a text file"]),
    "gzip and more": (gzip.compress(WELL.encode()) + b"x", {}, ["gzip file is dam"]),
    "only units": (HEADER + "-,N,N\n", {}, ["no data rows", "give at least"]),
    "no force to predict": (
        "fx,v\n1,2\n", {"forces": False}, ["no slip", "no load"]
    ),
    "unit to predict": (
        "kappa,fz\n0.1,2\n", {"forces": False, "units": {"fx": "deg"}},
        ["column 'fx'", "unit of angle"],
    ),
    "other unit to predict": (
        "kappa,fz\n0.1,2\n", {"forces": False, "units": {"v": "km/h"}},
        ["for v, which the file does not have"],
    ),
    "spreadsheet": (b"PK\x03\x04abc", {}, ["spreadsheet", "export the sheet as CSV"]),
    "broken utf-16": (b"\xff\xfek\x00a", {}, ["broken UTF-16"]),
    "broken gzip": (gzip.compress(WELL.encode())[:-9], {}, ["gzip file is damaged"]),
    "wrong point": (
        "kappa;fx;fz\n0,1;1;2\n0.2;2;2\n", {},
        ["row 2, column 'kappa'", "'0,1' has a comma"],
    ),
    # even when masking
    "nothing left": (
        "kappa,fx,fz\nx,1,2\n0.1,y,2\n", {"mask_bad_rows": True}, ["no usable rows"]
    ),
    "percent masked": (
        table("kappa,fx,fz", [0.5, 2, 3, 4], [1, 2, 3, 4], [9] * 4),
        {"mask_bad_rows": True}, ["3 of 4 rows", "--unit kappa=%"],
    ),
    "signs masked": (
        table("kappa,fx,fz", [*SLIP, "x"], [*FORCE, 1], [*LOAD, 1]),
        {"mask_bad_rows": True}, ["contradict"],
    ),
}  # fmt: skip


def write(tmp_path, content):
    path = tmp_path / "test file.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(("content", "options", "expected"), CASES.values(), ids=CASES)
def test_bad_data_are_refused_with_place_reason_and_remedy(tmp_path, content, options, expected):
    path = write(tmp_path, content)
    with pytest.raises(DataError) as caught:
        read(path, **options)
    message = "\n".join(map(str, caught.value.problems))
    for fragment in expected:
        assert fragment in message
    assert caught.value.exit_code == 3
    assert all(problem.file == str(path) for problem in caught.value.problems)
    assert all(problem.remedy for problem in caught.value.problems)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"convention": "iso"}, ["'iso'", "mean 'iso-w'", "valid: braking, iso-w"]),
        ({"slip": "kapa"}, ["--slip", "mean 'kappa'"]),
        ({"columns": {"fxx": "a"}}, ["--column or [data.columns]", "mean 'fx'"]),
        ({"units": {"forze": "N"}}, ["--unit or [data.units]", "'forze'", "valid:"]),
        ({"constants": {"kapa": 1.0}}, ["--constant or [data.constants]", "'kapa'"]),
        ({"constants": {"fz": -1.0}}, ["--constant fz=-1 is not a positive number"]),
        ({"constants": {"gamma": float("nan")}}, ["gamma=nan is not a finite number"]),
        ({"rolling_radius": -0.3}, ["--rolling-radius -0.3"]),
        ({"convention": "x", "slip": "y"}, ["--convention", "--slip"]),
    ],
)
def test_unknown_options_are_usage_errors(tmp_path, options, expected):
    with pytest.raises(UsageError) as caught:
        read(write(tmp_path, WELL), **options)
    assert caught.value.exit_code == 2
    for fragment in expected:
        assert fragment in "\n".join(map(str, caught.value.problems))


def test_a_missing_file_suggests_a_similar_name(tmp_path):
    write(tmp_path, WELL)
    with pytest.raises(DataError, match="did you mean 'test file.csv'"):
        read(tmp_path / "test_file.csv")
    for path, reason, remedy in (
        (tmp_path / "nowhere", "does not exist", "check the path"),
        (tmp_path / "no" / "where", "does not exist", "check the path"),
        (tmp_path, "cannot be read: Is a directory", "check the path and its perm"),
        (tmp_path / "test file.csv" / "x", "Not a directory", "check the path"),
        (tmp_path / "a\0b", "cannot be read: embedded null", "check the path"),
    ):
        with pytest.raises(DataError, match=reason) as caught:
            read(path)
        assert remedy in caught.value.problems[0].remedy


def test_a_file_without_permission_is_reported(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    path = write(tmp_path, WELL)
    monkeypatch.setattr("pathlib.Path.open", refuse)  # chmod does not stop root
    with pytest.raises(DataError, match="Permission denied") as caught:
        read(path)
    assert "permissions" in caught.value.problems[0].remedy


def test_bad_rows_are_masked_on_request_and_listed(tmp_path):
    bad = ["0.1,abc,4000", "0.1,1", "0.1,900,-1", "1.5,1,4000"]
    data = read(write(tmp_path, lines(*bad)), mask_bad_rows=True)
    assert data.used.tolist() == [True] * 4 + [False] * 4
    assert len(data) == 8 and data.n == 4
    assert sorted(problem.row for problem in data.source.masked) == [6, 7, 8, 9]
    assert np.isfinite(data.usable("sigma_x")).all()
    assert data.source.line.tolist() == [2, 3, 4, 5, 6, 7, 8, 9]


def test_many_masked_rows_are_grouped(tmp_path):
    content = lines(*["0.1,x,4000"] * 400)
    data = read(write(tmp_path, content), mask_bad_rows=True)
    assert data.n == 4
    assert len(data.source.masked) == 6
    assert "and 395 more rows" in str(data.source.masked[-1])
    *first, rest = data.first_masked()
    assert len(first) == 3 and rest == "400 rows in all"


def test_require_lists_what_a_model_needs(tmp_path):
    data = read(write(tmp_path, WELL))
    require(data, ["sigma_x", "fx"], "the brush model")
    with pytest.raises(DataError) as caught:
        require(data, ["v", "alpha"], "the model")
    message = "\n".join(map(str, caught.value.problems))
    assert "the model needs v (forward speed" in message
    assert "--constant v=VALUE [m/s]" in message
    assert "needs alpha (slip angle)" in message


@pytest.mark.parametrize(
    "frame",
    [
        {},
        {"kappa": [0.1, 0.2], "fx": [1.0], "fz": [1.0, 1.0]},
        {"kappa": [[0.1, 0.2]], "fx": [[1.0, 2.0]], "fz": [[1.0, 1.0]]},
        {"kappa": [], "fx": [], "fz": []},
    ],
)
def test_frames_of_wrong_shape_are_refused(frame):
    with pytest.raises(TirefitError, match="one-dimensional, equally long"):
        read_frame(frame)


def test_a_frame_is_checked_like_a_file_with_rows_from_zero():
    with pytest.raises(DataError, match="data, row 1, column 'fz'"):
        read_frame({"kappa": [0.1, 0.2, 0.3], "fx": [1, 2, 3], "fz": [9, -1, 9]})
    with pytest.raises(UsageError, match="iso-w"):
        read_frame({"kappa": [0.1], "fx": [1], "fz": [9]}, convention="iso")
