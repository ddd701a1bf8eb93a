"""``tirefit fit``: directories, exit codes and output for given files."""

import json
from contextlib import chdir

import numpy as np
import pytest
from typer.testing import CliRunner

from tirefit.cli.commands import app

STIFFNESS, FZ = 5e4, 4000.0
# The same static choices in every test, so that one compilation serves them all.
FAST = "solver = 'gauss-newton'\n[noise]\nfx = 40\n[posterior]\nwalkers = 16\n"


def write(path, mu=1.0, reach=0.2, n=400, seed=1, header="sigma_x,fx,fz", noise=40.0):
    generator = np.random.default_rng(seed)
    slip = generator.uniform(0, reach, n)
    x = np.minimum(slip * STIFFNESS / (1.5 * mu * FZ), 1.0)
    # S(12) written out: C s - (C s)^2/(3 mu F_z) + (C s)^3/(27 (mu F_z)^2)
    force = mu * FZ * (3 * x - 3 * x**2 + x**3) + noise * generator.standard_normal(n)
    rows = (f"{a:.9g},{b:.9g},{FZ:g}" for a, b in zip(slip, force, strict=True))
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "fit.toml").write_text(FAST)
    return write(tmp_path / "rig.csv")


def content(directory):
    return json.loads((directory / "fit.json").read_text())


def sampled(folder, toml, code):
    """The output of a fit of ``rig.csv`` with its posterior, beside it in ``folder``."""
    (folder / "fit.toml").write_text(toml)
    write(folder / "rig.csv")
    words = ("fit", "rig.csv", "--config", "fit.toml")
    with chdir(folder):
        result = CliRunner().invoke(app, words)
    assert result.exit_code == code, result.output
    return result


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with a fit, and the output of its command."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, sampled(folder, FAST, 0)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A folder with a fit whose chain is too short, and the output of its command."""
    folder = tmp_path_factory.mktemp("short")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tirefit.report.fit.figures.save_figures", lambda *_, **__: [])
        return folder, sampled(folder, FAST + "max_steps = 100\n", 4)


def test_fit_of_one_file_writes_its_posterior(whole):
    folder, result = whole
    found = folder / "rig"  # named after the file
    names = {path.name for path in found.iterdir()}
    assert {"fit.json", "posterior.nc", "fit.png", "corner.png"} <= names
    assert not any(name.startswith(".") for name in names)
    record = content(found)
    assert record["posterior"]["outcome"] == "converged"
    assert record["parameters"]["mu"]["ci95"][0] < 1.0 < record["parameters"]["mu"]["ci95"][1]
    assert record["data"]["sha256"] and record["data"]["file"].endswith("rig.csv")
    # No terminal, no bar: at most lines, where it takes long.
    said = result.stderr.splitlines()
    assert all(line.startswith("posterior: ") for line in said)
    assert "VERDICT: ok" in result.stdout and "posterior" in result.stdout
    assert len(result.stdout.splitlines()) <= 45 and "covariance" not in result.stdout


def test_out_names_the_directory(run, no_figures, rig, tmp_path):
    run("fit", rig, "--config", "fit.toml", "--no-posterior", "--out", "a/b")
    assert not (tmp_path / "rig").exists()
    assert {path.name for path in (tmp_path / "a" / "b").iterdir()} == {"fit.json", "fit.png"}
    assert content(tmp_path / "a" / "b")["posterior"] is None


def test_several_files_get_a_directory_each(run, no_figures, rig, tmp_path):
    write(tmp_path / "wet.csv", mu=0.7, seed=2)
    (tmp_path / "all").mkdir()
    (tmp_path / "all" / "fits.html").write_text("an earlier page, tirefit.fit/1")
    result = run("fit", rig, "wet.csv", "--config", "fit.toml", "--no-posterior", "--out", "all")
    assert sorted(p.name for p in (tmp_path / "all").iterdir()) == ["rig", "wet"]
    for name, mu in (("rig", 1.0), ("wet", 0.7)):
        found = content(tmp_path / "all" / name)["parameters"]["mu"]["value"]
        assert abs(found - mu) < 0.005
    summary = result.stdout.splitlines()[-8:]
    for name in ("all/rig", "all/wet"):
        assert any(line.strip().startswith(name) for line in summary)


def test_one_bad_file_does_not_stop_the_others(run, unrendered, rig, tmp_path):
    (tmp_path / "bad.csv").write_text("sigma_x,fx,fz\n0.1,oops,4000\n")
    result = run(
        "fit", "bad.csv", rig, "--config", "fit.toml", "--no-posterior", "--html", exit_code=3
    )
    assert "bad.csv" in result.stderr and "remedy" in result.stderr
    assert (tmp_path / "rig" / "fit.json").exists()
    assert not (tmp_path / "bad").exists()  # nothing half-written
    assert (tmp_path / "rig" / "fit.html").exists()
    page = (tmp_path / "fits.html").read_text()
    assert "of 2 files: 1 failed, 1 ok" in page and "bad.csv: failed" in page
    assert "wrote fits.html" in result.stdout


@pytest.mark.parametrize(
    ("text", "said"),
    [(None, "no.csv"), ("", "no.csv"), ("sigma_x,fx\n0,0\n0.1,9\n", "fz")],
    ids=["missing", "empty", "no load"],
)
def test_bad_data_write_nothing(run, tmp_path, text, said):
    if text is not None:
        (tmp_path / "no.csv").write_text(text)
    result = run("fit", "no.csv", exit_code=3)
    assert said in result.stderr and "Traceback" not in result.stderr
    assert result.stdout == ""
    assert not (tmp_path / "no").exists()


USAGE = {
    "model": (["--model", "brsh"], "did you mean"),
    "config": (["--config", "none.toml"], "none.toml"),
    "force": (["--force", "fq"], "is not one of 'fx', 'fy', 'mz'"),
    "solver": (["--solver", "newton"], "newton"),
    "seed": (["--seed", "-1"], "'--seed': "),
    "large seed": (["--seed", "4294967296"], "4294967295"),
    "no out": (["--out", ""], "'--out': it is empty"),
    "out is a file": (["--out", "rig.csv"], "rig.csv: no folder for the results"),
    "no radius": (["--rolling-radius", "0"], "--rolling-radius 0.0 is not a positive"),
    "radius": (["--rolling-radius", "-0.3"], "--rolling-radius -0.3 is not a pos"),
    "no config": (["--config", ""], "'--config': it is empty"),
    "no convention": (["--convention", ""], "--convention: '' is not known"),
    "twice": (["--unit", "fx=N", "--unit", "fx=kN"], "fx is given twice: 'N' and 'kN'"),
    "column": (["--column", "fx"], "'--column': 'fx': write it as NAME=VALUE"),
    "constant": (["--constant", "v=fast"], "not a valid number"),
    "convention": (["--convention", "iso"], "iso"),
    "option": (["--nonsense"], "--nonsense"),
}


@pytest.mark.parametrize(("arguments", "said"), USAGE.values(), ids=USAGE)
def test_wrong_use_gives_exit_code_2(run, rig, tmp_path, arguments, said):
    result = run("fit", rig, *arguments, exit_code=2)
    assert said in result.stderr
    assert not (tmp_path / "rig").exists()


def test_a_doubtful_convention_is_reported_before_and_in_the_report(run, no_figures, rig, tmp_path):
    rows = [line.split(",") for line in rig.read_text().splitlines()[1:]]
    iso = [f"{-float(slip)},{-float(force)},{fz}" for slip, force, fz in rows]
    (tmp_path / "iso.csv").write_text("\n".join(["sigma_x,fx,fz", *iso]) + "\n")
    arguments = ("fit", "iso.csv", "--config", "fit.toml", "--no-posterior")
    result = run(*arguments)
    assert "warning: iso.csv: no convention declared: read as braking" in result.stderr
    assert "--convention iso-w or adapted-sae" in result.stderr
    assert "warning: no convention declared" in " ".join(result.stdout.split())
    notes = content(tmp_path / "iso")["data"]["assumptions"]
    assert notes[0].startswith("warning: no convention declared")
    assert run(*arguments, "--convention", "iso-w").stderr == ""


def test_same_name_twice_is_refused(run, rig, tmp_path):
    (tmp_path / "other").mkdir()
    write(tmp_path / "other" / "rig.csv")
    result = run("fit", rig, "other/rig.csv", exit_code=2)
    assert "are named rig" in result.stderr
    assert not (tmp_path / "rig").exists()


def test_an_unknown_key_of_the_configuration_is_refused(run, rig, tmp_path):
    (tmp_path / "bad.toml").write_text("modell = 'brush'\n")
    result = run("fit", rig, "--config", "bad.toml", exit_code=2)
    assert "did you mean 'model'" in result.stderr and "bad.toml" in result.stderr


def test_command_line_overrides_the_configuration(run, no_figures, rig, tmp_path):
    (tmp_path / "other.toml").write_text("model = 'brush-d'\nseed = 4\n" + FAST)
    run("fit", rig, "--config", "other.toml", "--model", "brush", "--seed", "7", "--no-posterior")
    record = content(tmp_path / "rig")
    assert record["model"] == "brush" and record["seed"] == 7
    assert record["solver"] == "gauss-newton"  # what was not overridden stays
    assert record["noise"]["fx"]["source"] == "given"


def test_rows_below_the_peak_give_exit_code_6_and_their_range(run, no_figures, tmp_path):
    """To 0.42 of full sliding, where a brush has 1 - 0.58^3 = 80 % of its peak."""
    write(tmp_path / "below.csv", reach=0.05)
    words = ("fit", "below.csv", "--no-posterior", "--html", "--out", "out")
    output = " ".join(run(*words, exit_code=6).stdout.split())
    assert "VERDICT: friction rests on the shape of the model: mu 0." in output
    stored = content(tmp_path / "out")
    one = stored["peak_range"]["F_max_over_fz"]
    assert one["low"] < 1.0 < one["high"] and 0.75 < one["share"] < 0.85
    page = (tmp_path / "out" / "fit.html").read_text()
    assert "friction rests on the shape of the model" in page and f"{one['high']:.3g}" in page
    assert stored["outcomes"] == ["shape_dependent"]


def test_not_identified_gives_exit_code_5_only_with_strict(run, no_figures, tmp_path):
    # Slip to 17 % of full sliding, and noise that hides the bend.
    write(tmp_path / "low.csv", reach=0.02, noise=1200.0, seed=3)
    (tmp_path / "fit.toml").write_text(FAST.replace("40", "1200"))
    arguments = ("fit", "low.csv", "--config", "fit.toml", "--no-posterior")
    result = run(*arguments)
    assert "mu is not identified" in " ".join(result.stdout.split())
    run(*arguments, "--strict", exit_code=5)
    record = content(tmp_path / "low")["parameters"]["mu"]
    assert record["identified"] is False and record["std"] is None


def test_a_short_chain_gives_exit_code_4(short):
    folder, result = short
    assert "max_steps" in result.stdout
    assert content(folder / "rig")["posterior"]["steps"] == 100


def test_joint_fit_shares_the_tire_but_not_the_friction(run, unrendered, rig, tmp_path):
    write(tmp_path / "wet.csv", mu=0.7, seed=2)
    (tmp_path / "joint.toml").write_text(FAST + "[parameters.mu]\nper_run = true\n")
    run(
        "fit",
        rig,
        "wet.csv",
        "--joint",
        "--config",
        "joint.toml",
        "--no-posterior",
        "--out",
        "both",
    )
    record = content(tmp_path / "both")
    assert record["data"]["runs"] == ["rig", "wet"]
    found = record["parameters"]
    assert abs(found["mu[rig]"]["value"] - 1.0) < 0.005
    assert abs(found["mu[wet]"]["value"] - 0.7) < 0.005
    assert (tmp_path / "both" / "runs.png").exists()
    assert not (tmp_path / "rig").exists()


def test_html_writes_a_page_of_the_fit(run, unrendered, rig, tmp_path):
    quick = ("fit", rig, "--config", "quick.toml", "--no-posterior", "--out", "out")
    (tmp_path / "quick.toml").write_text(FAST)
    result = run(*quick, "--html")
    page = tmp_path / "out" / "fit.html"
    assert "wrote to out: " in result.stdout and ", fit.html" in result.stdout
    assert content(tmp_path / "out")["data"]["sha256"] in page.read_text()
    # That of an earlier fit would be taken for this one's.
    run(*quick)
    assert not page.exists()


def test_force_option_selects_the_lateral_force(run, no_figures, tmp_path):
    write(tmp_path / "both.csv", header="alpha,fy,fz")
    text = (tmp_path / "both.csv").read_text().splitlines()
    rows = [f"{row},0.01,500" for row in text[1:]]
    (tmp_path / "both.csv").write_text("\n".join(["alpha,fy,fz,sigma_x,fx", *rows]) + "\n")
    (tmp_path / "fit.toml").write_text(FAST.replace("fx", "fy"))
    run(
        "fit",
        "both.csv",
        "--force",
        "fy",
        "--unit",
        "alpha=rad",
        "--config",
        "fit.toml",
        "--no-posterior",
    )
    assert content(tmp_path / "both")["forces"] == ["fy"]


def test_least_squares_results_are_written_before_the_posterior(
    run, unrendered, rig, tmp_path, monkeypatch
):
    """Even if the sampling process is killed; figures are drawn once, with the posterior."""
    from tirefit.fitting.uncertainty import posterior

    seen = {}

    class Killed(BaseException):
        pass

    def killed(*_, **__):
        seen["fit"] = content(tmp_path / "rig")
        seen["files"] = {path.name for path in (tmp_path / "rig").iterdir()}
        raise Killed

    monkeypatch.setattr(posterior, "sample", killed)
    with pytest.raises(Killed):
        run("fit", rig, "--config", "fit.toml")
    assert seen["fit"]["posterior"] is None and "mu" in seen["fit"]["parameters"]
    assert "fit.json" in seen["files"] and not any(".png" in name for name in seen["files"])
    assert content(tmp_path / "rig") == seen["fit"]


def test_an_interrupted_chain_is_kept_like_a_short_one(
    run, no_figures, rig, short, tmp_path, monkeypatch
):
    from tirefit.fitting.uncertainty import posterior

    health, calls = posterior._health, []

    def interrupted(*arguments):
        calls.append(1)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return health(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(posterior, "_health", interrupted)
        files = (rig, write(tmp_path / "wet.csv"))
        result = run("fit", *files, "--config", "fit.toml", exit_code=4)
    assert "interrupted" in result.stdout
    assert "interrupted: the last 1 of 2 not fitted\n" in result.stderr
    assert not (tmp_path / "wet").exists()
    assert content(tmp_path / "rig")["posterior"]["steps"] == 100
    kept, expected = (content(folder / "rig")["parameters"] for folder in (tmp_path, short[0]))
    assert kept == expected
