"""Frames of polars and pandas, and named arrays: differences from files."""

import datetime

import numpy as np
import pandas as pd
import polars as pl
import pytest

import tirefit
from tirefit.data.accept import as_data
from tirefit.results import DataError

N = 40
SLIP = np.linspace(0.002, 0.12, N)
COLUMNS = {
    "time": np.arange(N) / 100,
    "sigma_x": SLIP,
    "fx": 3500 * np.tanh(20 * SLIP),
    "fz": np.full(N, 4e3),
}
RUNS = ["dry"] * 20 + ["wet"] * 20


def same(data, runs=("data",)):
    for name, values in COLUMNS.items():
        np.testing.assert_allclose(data[name], values, rtol=1e-12, atol=1e-9)
    assert data.runs == tuple(runs)


def test_polars_frames_are_read_in_every_form():
    frame = pl.DataFrame(COLUMNS)
    same(as_data(frame))
    same(as_data(frame.lazy()))
    same(as_data(frame.cast(pl.String)))
    with_runs = frame.with_columns(pl.Series("run", RUNS).cast(pl.Categorical))
    same(as_data(with_runs), ["dry", "wet"])
    stamps = [
        datetime.datetime(2026, 1, 1) + datetime.timedelta(seconds=float(t))
        for t in COLUMNS["time"]
    ]
    same(as_data(frame.with_columns(pl.Series("time", stamps))))
    since = [stamp - stamps[0] for stamp in stamps]
    same(as_data(frame.with_columns(pl.Series("time", since))))
    empty = frame.with_columns(
        pl.when(pl.col("time") < 0.015).then(None).otherwise(pl.col("fx")).alias("fx")
    )
    data = as_data(empty)
    assert data.n == N - 2
    assert data.source.warnings == (
        f"excluded 2 of {N} rows, which lack a value: 'fx' in rows 0, 1",
    )
    assert as_data(empty, mask_bad_rows=True).n == N - 2


def test_every_function_accepts_polars_frames():
    frame = pl.DataFrame(COLUMNS)
    result = tirefit.fit(frame)
    whole = tirefit.fit(COLUMNS)
    assert result.parameters["mu"].value == whole.parameters["mu"].value
    predicted = tirefit.predict(result, frame.lazy())["fx"]
    np.testing.assert_allclose(predicted, COLUMNS["fx"], atol=200)
    assert tirefit.inspect(frame).rows == N
    assert set(tirefit.estimate(frame, "rls").methods) == {"rls"}


def test_pandas_frames_are_read_in_every_form():
    frame = pd.DataFrame(COLUMNS)
    same(as_data(frame.set_index(np.arange(N)[::-1])))
    same(as_data(frame.convert_dtypes()))
    same(as_data(frame.assign(run=pd.Categorical(RUNS))), ["dry", "wet"])
    stamps = pd.Timestamp("2026-01-01") + pd.to_timedelta(COLUMNS["time"], unit="s")
    same(as_data(frame.assign(time=stamps)))
    same(as_data(frame.assign(time=stamps - stamps[0])))
    some = pd.Series(stamps)
    some[3] = pd.NaT
    data = as_data(frame.assign(time=some))
    np.testing.assert_array_equal(data.used, np.arange(N) != 3)
    assert "'time' in row 3" in data.source.warnings[0]


def test_a_masked_value_is_a_missing_value():
    fx = np.ma.masked_array(COLUMNS["fx"], mask=np.arange(N) == 3)
    for masks in (False, True):
        data = tirefit.read_frame(COLUMNS | {"fx": fx}, mask_bad_rows=masks)
        np.testing.assert_array_equal(data.used, np.arange(N) != 3)


def test_named_arrays_are_read():
    array = np.rec.fromarrays(list(COLUMNS.values()), names=list(COLUMNS))
    same(as_data(array))
    same(as_data(np.asarray(array)))


def test_an_error_in_the_units_row_names_that_row(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("sigma_x,fx,fz\n-,parsec,N\n0.01,900,4000\n0.02,1800,4000\n")
    with pytest.raises(DataError, match="row 2, column 'fx'"):
        tirefit.read(path)
    path.write_text("sigma_x,fx [parsec],fz\n0.01,900,4000\n0.02,1800,4000\n")
    with pytest.raises(DataError, match="row 1, column 'fx"):
        tirefit.read(path)
