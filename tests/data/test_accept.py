"""Every public function accepts data in the forms that users have."""

import numpy as np
import pandas as pd
import pytest

import tirefit
from tirefit.data.accept import as_data
from tirefit.data.table import TireData
from tirefit.results import DataError, InputProblem, UsageError, in_python

SLIP = np.linspace(0.002, 0.12, 40)
COLUMNS = {"sigma_x": SLIP, "fx": 3500 * np.tanh(20 * SLIP), "fz": np.full(40, 4e3)}


class Frame:
    """The common part of polars and similar frames: names, and a column by its name;
    iterating gives columns."""

    columns = tuple(COLUMNS)

    def __getitem__(self, name):
        return COLUMNS[name]

    def __iter__(self):
        return iter(COLUMNS.values())


@pytest.fixture(params=["table", "path", "text", "pandas", "frame", "mapping"])
def given(request, tmp_path):
    """The same data in every form."""
    frame, path = pd.DataFrame(COLUMNS), tmp_path / "rig.csv"
    frame.to_csv(path, index=False, float_format="%.17g")
    return {
        "table": tirefit.read(path),
        "path": path,
        "text": str(path),
        "pandas": frame,
        "frame": Frame(),
        "mapping": COLUMNS,
    }[request.param]


def test_the_same_data_are_accepted_in_every_form(given):
    for data in [as_data(given)] + [tirefit.read(given)] * (not isinstance(given, TireData)):
        for name, values in COLUMNS.items():
            np.testing.assert_array_equal(data[name], values)


def test_only_needed_columns_are_required():
    inputs = {name: COLUMNS[name] for name in ("sigma_x", "fz")}
    assert tirefit.predict("brush", inputs)["fx"].shape == (40,)
    log = COLUMNS | {"time": np.arange(40) / 100}
    assert set(tirefit.estimate(log, "rls").methods) == {"rls"}
    with pytest.raises(DataError, match="no load: fz is needed"):
        tirefit.fit({name: COLUMNS[name] for name in ("sigma_x", "fx")})


def test_anything_else_is_refused():
    for accepts in (tirefit.fit, tirefit.read):
        with pytest.raises(UsageError, match="data of type bytes: give what"):
            accepts(b"rig.csv")


@pytest.mark.parametrize(
    ("option", "argument"),
    [
        ("--column fz=HEADER, or", "columns={'fz': 'HEADER'}, or"),
        ("give --constant fz=4000 [N]", "give constants={'fz': 4000} [N]"),
        ("pass --unit fx=-N", "pass units={'fx': '-N'}"),
        ("one of --column fx= and", "one of columns={'fx': '...'} and"),
        ("--convention iso-w or sae", "convention='iso-w' or sae"),
        ("give --rolling-radius R [m]", "give rolling_radius=R [m]"),
        ("without --mask-bad-rows", "without mask_bad_rows=True"),
        ("a - b -- c --other d", "a - b -- c --other d"),
    ],
)
def test_an_error_names_arguments_where_a_function_was_called(option, argument):
    """The problem itself keeps the words of the command line."""
    assert in_python(option) == argument
    error = DataError(InputProblem("it fails", option))
    assert argument in str(error) and option in str(error.problems[0])
