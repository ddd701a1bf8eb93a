"""The sign convention of a file comes from the user, the file, a model or the default;
it is reported, and two contradicting statements are an error."""

import numpy as np
import pytest
from test_read_layouts import truth, ttc
from test_read_signs import canonical, in_signs

from tirefit.data.read import read, read_frame
from tirefit.data.table import join
from tirefit.results import DataError
from tirefit.slip import CONVENTIONS

MODEL = ("iso-w", "tire.tir")
LINES = {
    "of this package": "# tirefit 0.1.0: prepared from run.dat, convention {}",
    "a comment": "# convention: {}",
    "a title": "Rig 3, sign convention is {}",
    "an equals sign": "# CONVENTION = '{}'",
}


def written(path, columns, first=""):
    rows = zip(*columns.values(), strict=True)
    lines = [first] if first else []
    lines += [",".join(columns), *(",".join(f"{x:.12g}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def longitudinal():
    return {name: canonical()[name] for name in ("sigma_x", "fx", "fz")}


def same(data, columns):
    for name, values in columns.items():
        np.testing.assert_allclose(data[name], values, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_a_convention_in_the_file_overrides_that_of_a_model(tmp_path, line, convention):
    frame = in_signs(canonical(), convention)
    data = read(
        written(tmp_path / "a.csv", frame, line.format(convention.upper())),
        otherwise=("sae" if convention == "braking" else "braking", "a model"),
    )
    same(data, canonical())
    assert data.source.convention == convention
    assert any("stated in line 1, not as" in note for note in data.source.notes)


def test_a_convention_below_the_header_counts_and_an_unknown_one_is_reported(tmp_path):
    text = written(tmp_path / "a.csv", in_signs(canonical(), "sae"), "").read_text().lstrip()
    header, rows = text.split("\n", 1)
    for line in ("# convention sae", "# convention xyz"):
        path = tmp_path / "below.csv"
        path.write_text(f"{header}\n{line}\n{rows}")
        if line.endswith("sae"):
            data = read(path)
            same(data, canonical())
            assert any("stated in line 2" in note for note in data.source.notes)
        else:
            said = read(path, convention="sae").source.warnings
            assert any("line 2 states the convention 'xyz'" in text for text in said)


def test_a_convention_of_a_model_overrides_the_default_and_is_reported(tmp_path):
    path = written(tmp_path / "a.csv", in_signs(longitudinal(), "iso-w"))
    data = read(path, otherwise=MODEL)
    same(data, longitudinal())
    (text,) = data.source.warnings
    assert "read as iso-w, that of tire.tir, so negative 'sigma_x'" in text
    assert "pass --convention braking; if it means driving, --convention iso-w" in text
    assert any("'iso-w' assumed, that of tire.tir" in n for n in data.source.notes)
    same(read(path, convention="iso-w"), longitudinal())
    same(read(path, convention="iso-w", otherwise=("braking", "m")), longitudinal())


def test_contradicting_conventions_are_refused_if_a_sign_differs(tmp_path):
    frame = in_signs(canonical(), "iso-w")
    path = written(tmp_path / "a.csv", frame, "# convention iso-w")
    with pytest.raises(DataError) as caught:
        read(path, convention="braking")
    (problem,) = caught.value.problems
    assert (problem.row, problem.file) == (1, str(path))
    for name in ("sigma_x", "fx", "fy", "mz"):
        assert name in problem.reason.split("'iso-w':")[1]
    assert "--convention braking" in problem.reason
    assert "leave out --convention" in problem.remedy
    # No problem: the same statement twice, or a sign of a missing column.
    same(read(path, convention="iso-w"), canonical())
    path = written(tmp_path / "b.csv", in_signs(longitudinal(), "iso-w"), "# convention iso-w")
    data = read(path, convention="adapted-sae")
    same(data, longitudinal())
    assert any("not 'iso-w' (stated in line 1)" in note for note in data.source.notes)


def test_contradicting_or_unknown_convention_lines_are_refused(tmp_path):
    twice = "# convention iso-w\n# convention sae"
    with pytest.raises(DataError, match="(?s)'sae' contradicts 'iso-w' in line 1"):
        read(written(tmp_path / "a.csv", longitudinal(), twice))
    path = written(tmp_path / "b.csv", longitudinal(), "# convention DIN 70000")
    (_, text) = read(path).source.warnings
    assert "line 1 states the convention 'DIN'" in text and "iso-w" in text


def test_user_and_file_override_the_convention_of_a_layout(tmp_path):
    """A consortium file: its layout alone implies SAE, as its loads are negative."""
    frame = ttc(truth())
    data = read(written(tmp_path / "a.csv", frame))
    assert data.source.convention_from == "by the layout of the file"
    data = read(written(tmp_path / "b.csv", frame, "# convention sae"), otherwise=MODEL)
    assert data.source.convention == "sae"
    assert data.source.convention_from == "stated in line 1, not as 'iso-w' of tire.tir"
    positive = frame | {name: -frame[name] for name in ("FZ", "SA", "FY", "MZ")}
    path = written(tmp_path / "c.csv", positive)
    layout = read(path).source.convention
    assert layout == "iso-w"
    data = read(path, convention="adapted-sae", units={"fy": "-N", "mz": "-Nm"})
    assert data.source.convention_from == f"as declared, not {layout!r} (by the layout of the file)"


def test_files_with_different_conventions_can_be_joined(tmp_path):
    tables = [
        read(
            written(
                tmp_path / f"{name}.csv",
                in_signs({**canonical(), "fz": canonical()["fz"] + i}, name),
                f"# convention {name}",
            )
        )
        for i, name in enumerate(CONVENTIONS)
    ]
    data = join(tables)
    same(data, {n: np.tile(canonical()[n], 4) for n in ("sigma_x", "fy", "mz")})
    assert any("several conventions: braking, iso-w" in n for n in data.source.notes)


def test_simulated_and_measured_force_must_have_the_same_sign(tmp_path):
    for slip, force in (("sigma_x", "fx"), ("alpha", "fy")):
        frame = {name: canonical()[name] for name in (slip, force, "fz")}
        right = frame | {f"{force}_sim": 0.9 * frame[force]}
        assert f"{force}_sim" in read_frame(right, convention="braking")
        with pytest.raises(DataError, match=f"(?s){force}_sim.*{force}_sim.: .-N"):
            read_frame(frame | {f"{force}_sim": -frame[force]}, convention="braking")


def test_zero_camber_does_not_show_its_sign():
    columns = canonical()
    for gamma in (0 * columns["gamma"], 0 * columns["gamma"] + 0.002):
        frame = columns | {"gamma": -gamma}
        assert read_frame(frame, convention="braking").source.warnings == ()
    # A few rows under camber in one sweep of the slip do not determine the sign.
    few = np.where(np.arange(240) > 230, 0.07, 0.0)
    frame = columns | {"gamma": -few, "fy": columns["fy"] - 2800 * columns["gamma"]}
    assert read_frame(frame, convention="braking").source.warnings == ()
