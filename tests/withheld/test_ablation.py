"""fits/ablation and fits/calibration on records made by hand, and on one trial."""

import json
import pickle

import numpy as np
import pytest
from scipy.special import expit, logit

from fits.ablation import collect, table
from fits.ablation.records import loaded
from fits.ablation.variants import VARIANTS, Rules, decided, reproduced, stated_unlisted, weighed_of
from fits.calibration import logistic
from fits.withheld import generate
from tirefit.diagnosis.decide.verdict import POLICY, Policy, Status

NUMBERS = {"unlisted": (-4.0, 1.0)}
"""Something unlisted where the evidence says so by log odds of four."""

RISING, OFFSET = "friction_speed_linear", "slip_offset"


def label(kind="singles", effects=(RISING,), **given):
    return {
        "set": kind,
        "effects": list(effects),
        "families": [],
        "kind": "iid",
        "gap_over_noise": 1.0,
        "file": "rig00/t0.csv",
        **given,
    }


def record(name="t/t0", *, alone=20.0, beside=0.0, errors=9.0, gain=(30.0, 3.0), **of):
    """A file with one good set; ``alone``: its log evidence, ``beside``: that of a
    sharp shape in its remainder."""
    key, some = (RISING,), {"smooth": -1.0, "waves": beside}
    hypotheses = [
        ((), 0.0, -1.0, 0.0, True),
        (key, alone, -4.0, 0.0, True),
        ((OFFSET,), 1.0, -4.0, 0.0, True),
        ((OFFSET, RISING), alone + 1.0, -8.0, -0.5, True),
    ]
    keys = [hypothesis[0] for hypothesis in hypotheses]
    return {
        "name": name,
        "label": label(**of),
        "hypotheses": hypotheses,
        "family": {RISING: "friction x speed", OFFSET: "friction x speed"},
        "weighed": {
            "evidence": {h[0]: h[1] for h in hypotheses},
            "other_form": [],
            "gains": {k: some | {"patterns": beside} for k in keys},
        },
        "out": {
            "across_runs": False,
            "effects": ((), key),
            "climbed": (),
            "loss": np.array([[4.0, 1.0], [4.0, 1.0]]),
            "rows": np.array([5, 5]),
        },
        "fitted": {key: ({RISING: errors}, {RISING: (*gain, 0.9, 0.05, 2)})},
        "found": {"unlisted": 0.1},
        "flags": [],
        "seconds": {"in all": 1.0, "climbed": 0.25},
    }


# --- variants -----------------------------------------------------------------------


def test_a_sufficient_set_is_named():
    answer = decided(record(), Rules(), NUMBERS)
    assert (answer.status, answer.effects) == (str(Status.NAMED), (RISING,))
    plain = decided(record(), Rules(plain=True), {})
    assert (plain.status, plain.effects) == (answer.status, answer.effects)


def test_no_gap_gives_none_and_odd_noise_gives_noise():
    quiet = record(alone=-3.0, beside=-3.0)
    for rules in (Rules(), Rules(plain=True)):
        assert decided(quiet, rules, NUMBERS).status == str(Status.NONE)
    odd = decided(quiet | {"flags": ["autocorrelated"]}, Rules(), NUMBERS)
    assert odd.effects == ("noise_autocorrelated",)
    assert odd.kind == "noise"


@pytest.mark.parametrize(
    ("weak", "off"),
    [
        ({"errors": POLICY.known / 2}, "known: amplitude over error not required"),
        ({"gain": (1.0, 3.0)}, "gain: no data left out"),
    ],
)
def test_without_a_rule_the_name_passes(weak, off):
    assert decided(record(**weak), Rules(), NUMBERS).effects != (RISING,)
    assert decided(record(**weak), VARIANTS[off], NUMBERS).effects == (RISING,)


def test_the_unlisted_removes_no_name():
    strange = record(beside=12.0)
    answer = decided(strange, Rules(), NUMBERS)
    assert (answer.status, answer.effects) == (str(Status.INCOMPLETE), (RISING,))
    by_evidence = decided(strange, Rules(calibrated=False), {})
    assert by_evidence.status == str(Status.INCOMPLETE)
    without = Rules(without=("waves",))
    gains = weighed_of(strange, without).gains[(RISING,)]
    assert gains.keys() == {"smooth", "patterns"}


def test_each_stage_can_be_removed():
    pair = (OFFSET, RISING)
    on = weighed_of(record(), Rules()).log_weight
    doubt = weighed_of(record(), Rules(doubt=False)).log_weight
    assert doubt[pair] - on[pair] == pytest.approx(0.5)
    assert doubt[(RISING,)] == on[(RISING,)]


def test_runs_that_the_search_predicts_best_are_used():
    strange = record(beside=12.0)
    out = strange["out"] | {"across_runs": True, "climbed": (OFFSET,)}
    climbed = decided(strange | {"out": out}, Rules(each=False), NUMBERS)
    assert climbed.effects == (OFFSET,)
    off = decided(strange | {"out": out}, Rules(each=False, climb=False), NUMBERS)
    assert off.effects == (RISING,)


def test_every_row_of_the_table_changes_a_setting():
    assert len(set(VARIANTS.values())) == len(VARIANTS)
    assert VARIANTS["as shipped"] == Rules(Policy())


# --- table --------------------------------------------------------------------------


def test_the_table_counts_named_effects(tmp_path):
    first = [record(f"a/t{k}", alone=20.0 - 25.0 * (k % 2)) for k in range(6)]
    for k in range(6):
        strange = label("unlisted", ()) | {"kind": f"k{k}"}
        first.append(record(f"a/s{k}", beside=12.0) | {"label": strange})
    text = table.table(first, first[:1] + first[6:8], before=tmp_path)
    rows = [[cell.strip() for cell in line.split("|")] for line in text.split("\n")]
    head = rows[0]
    product = next(row for row in rows if row[1:2] == ["as shipped"])
    cells = dict(zip(head, product, strict=True))
    assert cells["strong: exact"] == "1.00"
    assert cells["unlisted, strong"] == "1.00"
    assert cells["false names per trial"] == "1.00"
    assert cells["CPU s"] == "1.00"
    assert len([row for row in rows if len(row) > 3]) == 3 + len(VARIANTS)


# --- calibration --------------------------------------------------------------------


def test_probabilities_agree_with_the_share_of_right_answers_in_both_halves():
    generator = np.random.default_rng(5)
    told = generator.uniform(0.2, 0.99, 8000)
    right = generator.uniform(size=8000) < expit(-0.4 + 0.5 * logit(told))
    verdicts = list(zip(["none"] * 8000, told, right, strict=True))
    found = logistic.checked(verdicts, [k % 2 for k in range(8000)])
    assert found["calibration error"] < 0.02 < found["calibration error before"]
    lines = logistic.lines_of(verdicts)
    assert lines["none"] == pytest.approx([-0.4, 0.5], abs=0.1)
    assert logistic.calibrated(lines, "named", 0.7) == pytest.approx(0.7)


def test_changed_measured_files_are_not_used_for_the_unlisted():
    some = [record(kind=kind) for kind in ("singles", "injected", "raw")]
    assert len(stated_unlisted(some, Rules())) == 1


# --- one trial ----------------------------------------------------------------------


def test_a_record_gives_the_verdict_of_the_product(tmp_path, capsys):
    folder, out = tmp_path / "521", tmp_path / "records"
    asked = "--seed 521 --trials 1 --set singles --design C --noise rig --rows 200"
    generate.main([*asked.split(), "--out", str(folder)])
    ((name, trial),) = json.loads((folder / "labels.json").read_text()).items()
    path = folder / "trials" / trial["file"]
    import tirefit

    kept = collect.diagnosed(tirefit.read(str(path)), rig=path.parent / "rig.toml")
    (out / "521").mkdir(parents=True)
    (out / "521" / f"{name}.pickle").write_bytes(pickle.dumps(kept))
    (again,) = loaded(out / "521")
    assert reproduced(again)
    assert again["seconds"]["search"] < again["seconds"]["in all"]
    capsys.readouterr()
