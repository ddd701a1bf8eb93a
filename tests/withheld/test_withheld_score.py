"""Judge, scorer and baselines of fits/withheld on answers of known quality."""

import json

import numpy as np
import pytest

from fits.withheld import baselines, generate, library, run, score, thresholds, trials
from fits.withheld.designs import DESIGNS, make_world
from fits.withheld.judge import judge, true_closure


def label(*effects, **given):
    kind = "singles" if len(effects) == 1 else "pairs" if effects else "null"
    return {
        "effects": list(effects), "set": kind, "kind": "iid", "design": "G",
        "noise": "rig", "n": 900, "force": "fx", "forms": ["-"] * len(effects),
        "root_lambda": 20.0, "leave_out": None, **given,
    }  # fmt: skip


def answer(status, effects, probability, also=(), candidates=(), gap=None):
    listed = candidates or [(effects, probability)]
    return {
        "verdict": {
            "status": status,
            "effects": effects,
            "probability": probability,
            "also_possible": list(also),
        },
        "candidates": [{"effects": e, "family": "?", "probability": p} for e, p in listed if e],
        "gap": gap or {},
    }


def judged(truth, found):
    return judge("t", truth, found)


def test_exact_family_and_wrong_answers_are_distinguished():
    truth = label("friction_speed_linear")
    exact = judged(truth, answer("named", ["friction_speed_linear"], 0.95))
    kin = judged(truth, answer("named", ["friction_speed_exponential"], 0.95))
    wrong = judged(truth, answer("named", ["slip_offset"], 0.95))
    assert (exact.exact, exact.family, exact.sure_wrong) == (True, True, False)
    assert (kin.exact, kin.family, kin.sure_wrong) == (False, True, True)
    assert (wrong.exact, wrong.family, wrong.sure_wrong) == (False, False, True)
    assert exact.right
    assert kin.family_right
    assert not wrong.right


def test_half_a_pair_is_wrong():
    truth = label("slip_offset", "load_friction")
    half = judged(truth, answer("named", ["slip_offset"], 0.95))
    both = judged(truth, answer("named", ["load_friction", "slip_offset"], 0.6))
    assert not half.exact
    assert half.sure_wrong
    assert both.exact
    beside = judged(truth, answer("incomplete", ["slip_offset"], 0.95))
    assert not beside.sure_wrong  # it says that something is missing


@pytest.mark.parametrize(
    ("found", "flagged"),
    [
        (answer("none", [], 0.9), False),
        (answer("named", ["outliers"], 0.8), False),
        (answer("none", ["noise_autocorrelated"], 0.8), False),
        (answer("cannot_tell", ["slip_offset"], 0.4), True),
        (answer("unknown", ["unknown"], 0.7), True),
        (answer("incomplete", ["slip_offset"], 0.7), True),
    ],
)
def test_false_alarms_are_counted(found, flagged):
    outcome = judged(label(), found)
    assert outcome.flagged == flagged
    assert outcome.right == (not flagged)


def test_for_the_unlisted_unknown_or_incomplete_is_right():
    truth = label(set="unlisted")
    assert judged(truth, answer("unknown", ["unknown"], 0.8)).right
    assert judged(truth, answer("incomplete", ["slip_offset"], 0.95)).right
    named = judged(truth, answer("named", ["slip_offset"], 0.95))
    assert named.sure_wrong
    assert not named.unknown
    assert not judged(truth, answer("cannot_tell", ["slip_offset"], 0.95)).sure_wrong


def test_cannot_tell_is_scored():
    truth = label("force_offset")
    both = answer("cannot_tell", ["slip_offset"], 0.5, also=["force_offset"])
    assert judged(truth, both).exact_or_alias
    assert not judged(truth, both).exact
    other = answer("cannot_tell", ["slip_offset"], 0.5, also=["load_friction"])
    assert not judged(truth, other).exact_or_alias
    # Alternatives to a definite answer do not count.
    sure = answer("named", ["slip_offset"], 0.5, also=["force_offset"])
    assert not judged(truth, sure).exact_or_alias


def test_rank_and_coverage_of_candidates_are_scored():
    truth = label("slip_offset")
    ranked = [
        (["load_friction"], 0.6),
        (["load_stiffness"], 0.2),
        (["conicity"], 0.15),
        (["slip_offset"], 0.05),
    ]
    o = judged(truth, answer("named", ["load_friction"], 0.6, candidates=ranked))
    assert (o.top3, o.top5, o.covered, o.set_size) == (False, True, False, 3)
    o = judged(truth, answer("named", ["load_friction"], 0.6, candidates=ranked[2:]))
    assert (o.top3, o.covered, o.set_size) == (True, True, 2)


def test_the_probability_of_a_family_is_the_sum():
    ranked = [(["friction_speed_linear"], 0.5), (["friction_speed_exponential"], 0.3)]
    found = answer("named", ["friction_speed_linear"], 0.5, candidates=ranked)
    o = judged(label("friction_speed_exponential"), found)
    assert o.family_probability == pytest.approx(0.8)
    assert o.probability == 0.5


def test_calibration_agrees_with_hand_calculation():
    sure = answer("named", ["slip_offset"], 0.95)
    outcomes = [judged(label("slip_offset"), sure)] * 3
    outcomes += [judged(label("conicity"), sure)]
    # Three of four right at .95: |.95 - .75|; (3 * .05^2 + .95^2) / 4.
    assert thresholds.expected_calibration_error(outcomes) == pytest.approx(0.2)
    assert thresholds.brier(outcomes) == pytest.approx((3 * 0.0025 + 0.9025) / 4)
    assert thresholds.brier([]) is None


def test_true_closure_agrees_with_hand_calculation():
    truth = {"fx": np.array([10.0, 10.0, 10.0, 99.0])}
    rows = {
        "base_fx": np.array([6.0, 14.0, 6.0, 0.0]),
        "extended_fx": np.array([9.0, 11.0, 9.0, 0.0]),
        "masked": np.array([0, 0, 0, 1]),
    }
    assert true_closure(rows, truth, "fx") == pytest.approx(0.75)


def test_an_injected_effect_counts_only_if_not_found_in_the_raw_rows():
    def half(which, *effects):
        return label(*effects, set="injected" if effects else "raw", half=which)

    labels = {
        "raw0": half(0),
        "raw1": half(1),
        "a": half(0, "slip_offset"),
        "b": half(1, "slip_offset"),
        "c": half(1, "channel_delay"),
    }
    both = answer("named", ["load_friction", "slip_offset"], 0.7)
    answers = {
        "raw0": answer("named", ["load_friction"], 0.7),
        "raw1": both,
        "a": both,
        "b": both,
        "c": both,
    }
    outcomes = {name: judge(name, labels[name], answers[name]) for name in labels}
    counted = thresholds.telling(labels, outcomes)
    assert {o.name: o.exact for o in counted} == {"a": True, "c": False}


def written(tmp_path, trials_and_answers, rows=True):
    """A folder with sealed labels and answers, as generate and run leave it."""
    found = [trial for trial, _ in trials_and_answers]
    generate.write_all(found, tmp_path)
    labels = json.loads((tmp_path / "labels.json").read_text())
    for (name, mark), (trial, document) in zip(labels.items(), trials_and_answers, strict=True):
        path = tmp_path / "answers" / mark["file"].replace(".csv", ".json")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(document))
        if rows:
            truth = trial.truth[mark["force"]]
            lines = [f"{x - 4},{x - 1},0" for x in truth]
            header = f"base_{mark['force']},extended_{mark['force']},masked"
            text = "\n".join([header, *lines]) + "\n"
            path.with_suffix(".rows.csv").write_text(text)
        assert name in labels
    return labels


@pytest.fixture(scope="module")
def few():
    """Four singles and two nulls of design G, small."""
    singles = trials.draw(3, 4, ["singles"], ["F"], ["rig"], [200], False)
    return singles + trials.draw(4, 2, ["null"], ["F"], ["rig"], [200], False)


def perfect(trial, probability=1.0):
    effects = trial.label["effects"]
    gap = {"closed": 0.75, "closed_ci": [0.7, 0.8], "resolvable": True, "holdout": {"closed": 0.8}}
    return answer("named" if effects else "none", effects, probability, gap=gap)


def test_perfect_answers_have_a_perfect_score(few, tmp_path, capsys):
    written(tmp_path, [(trial, perfect(trial)) for trial in few])
    score.main([str(tmp_path)])
    document = json.loads((tmp_path / "score.json").read_text())
    found = document["methods"]["tirefit"]
    assert document["missing"] == []
    assert found["top-1 exact"] == [1.0, 4]
    assert found["false alarm"] == [0.0, 2]
    assert found["calibration error"] == [0.0, 6]
    assert found["closure, median |claimed - true|"][0] == pytest.approx(0, abs=1e-6)
    assert found["true closure inside the interval"] == [1.0, 6]
    assert "| top-1 exact | 1.000 (4) |" in capsys.readouterr().out
    checks = {c["requirement"]: c["verdict"] for c in document["thresholds"]}
    assert checks["confident and wrong, listed effects"] == "pass"
    assert checks["pairs in the top 5"] == "not measured"


def test_missing_answers_are_listed(few, tmp_path):
    written(tmp_path, [(trial, perfect(trial)) for trial in few])
    next(tmp_path.glob("answers/*/t0002.json")).unlink()
    score.main([str(tmp_path)])
    assert json.loads((tmp_path / "score.json").read_text())["missing"] == ["t0002"]
    assert (tmp_path / "score.md").read_text().startswith("1 trials without an answer")


def test_a_broken_seal_is_refused(few, tmp_path):
    written(tmp_path, [(trial, perfect(trial)) for trial in few], rows=False)
    path = tmp_path / "labels.json"
    path.write_text(path.read_text().replace("rig", "rug", 1))
    with pytest.raises(SystemExit, match="was changed"):
        score.main([str(tmp_path)])


def test_a_group_runs_with_its_command(tmp_path):
    group = tmp_path / "trials" / "rig00"
    group.mkdir(parents=True)
    for name in ("t0001.csv", "t0000.csv"):
        (group / name).touch()
    words = run.command(group, ["slip_offset", "conicity"], tmp_path / "out")
    assert words[1] == "diagnose"
    assert words[2:4] == [str(group / "t0000.csv"), str(group / "t0001.csv")]
    assert words[words.index("--rig") + 1] == str(group / "rig.toml")
    left_out = [b for a, b in zip(words, words[1:], strict=False) if a == "--without"]
    assert left_out == ["slip_offset", "conicity"]
    assert not any("label" in word or "truth" in word for word in words)


def as_inputs(world):
    stds = (0.001, 0.01 * world.fz, 0.001 * world.fz)
    return library.Inputs(world.time, world.run, world.slip, world.fz, world.v, "fx", stds)


@pytest.fixture(scope="module")
def strong():
    """Friction that differs between drive and brake, and the message about it."""
    world = make_world(DESIGNS["F"], 150, 5e4, 0.9, np.random.default_rng(5))
    x = as_inputs(world)
    truth = library.predict(x, "drive_brake_asymmetry", 0.15, 5e4, 0.9)
    noise = 0.01 * world.fz * np.random.default_rng(6).normal(size=150)
    return x, truth, truth + noise


@pytest.mark.parametrize("method", [baselines.by_bic, baselines.by_residual])
def test_baselines_name_a_strong_effect(strong, method):
    x, _, observed = strong
    found = method(x, observed)
    assert found["verdict"]["effects"] == ["drive_brake_asymmetry"]
    assert judged(label("drive_brake_asymmetry"), found).exact
    without = method(x.without(["drive_brake_asymmetry"]), observed)
    listed = [e for c in without["candidates"] for e in c["effects"]]
    assert "drive_brake_asymmetry" not in listed


def test_wrong_answers_have_score_zero(few, tmp_path):
    def wrong(trial):
        other = "camber_thrust"
        return answer("named", [other], 0.99)

    written(tmp_path, [(trial, wrong(trial)) for trial in few])
    score.main([str(tmp_path)])
    document = json.loads((tmp_path / "score.json").read_text())
    found = document["methods"]["tirefit"]
    assert found["top-1 exact"] == [0.0, 4]
    assert found["false alarm"] == [1.0, 2]
    assert found["confident and wrong, listed"] == [1.0, 4]
    assert found["calibration error"][0] == pytest.approx(0.99)
    checks = {c["requirement"]: c["verdict"] for c in document["thresholds"]}
    assert checks["confident and wrong, listed effects"] == "FAIL"
