"""Simulators with wrong parameters for a measurement: files, truth and score."""

import numpy as np
import pytest

from fits.withheld import trials
from fits.withheld.judge import judge
from fits.withheld.patch import plain_brush


def drawn(seed, count, designs=("F", "G"), rows=200):
    return trials.draw(seed, count, ["simulators"], designs, ["rig"], [rows], False)


@pytest.fixture(scope="module")
def beside():
    return drawn(511, 16)


def test_parameter_errors_are_between_5_and_25_percent(beside):
    off = np.array(
        [
            about["simulated"] / about["true"] - 1
            for trial in beside
            for about in trial.label["parameters"].values()
        ]
    )
    assert np.all((np.abs(off) >= 0.05) & (np.abs(off) <= 0.25))
    assert np.any(off > 0) and np.any(off < 0)


def test_the_simulated_force_is_a_brush_at_the_slip_as_logged(beside):
    for trial in beside:
        said, x = trial.label["parameters"], trial.columns
        wanted = plain_brush(
            x["sigma_x"], x["fz"], said["cpa2"]["simulated"], said["mu"]["simulated"]
        )[0]
        assert x["fx_sim"] == pytest.approx(wanted)


def test_a_lateral_simulator_gives_the_moment_too():
    (trial,) = drawn(512, 1, ("H",))
    assert {"fy_sim", "mz_sim"} <= trial.columns.keys()


def test_the_budget_sums_to_the_measured_distance(beside):
    for trial in beside:
        shares = trial.label["budget"]
        assert sum(shares.values()) == pytest.approx(1, abs=1e-4)
        assert min(shares.values()) >= 0
        distance = np.mean((trial.columns["fx"] - trial.columns["fx_sim"]) ** 2)
        noise = np.mean((trial.columns["fx"] - trial.truth["fx"]) ** 2)
        # Apart from what noise and gap share by chance.
        assert shares["noise"] == pytest.approx(noise / distance, rel=0.35)


def test_shares_agree_with_shapley_values():
    """A force offset: the closure has a closed form for both orders."""
    draw = trials.Draw(np.random.default_rng(3), ["F"], ["rig"], [400], False)
    world = draw.tire()
    size = 0.05
    change = trials.EFFECTS["force_offset"].forms["force_zero"]
    again = trials.at_other_values(world, [(change, size, None)])
    made = trials.trial(
        draw,
        again(world.c, world.mu, 1.0),
        "iid",
        ["force_offset"],
        forms=["force_zero"],
        amplitudes=[size],
        set="singles",
    )
    made = trials.replace(made, again=again)
    found = trials.with_simulator(made, draw)
    x, truth = found.columns, found.truth["fx"]
    off = truth - x["fx_sim"]
    nothing = np.mean(off**2)
    # The zero alone closes the mean, apart from the weights of the noise.
    alone = np.mean((off - np.mean(off)) ** 2)
    shares = found.label["budget"]
    total = nothing + np.mean((x["fx"] - truth) ** 2)
    tuned = 2 * shares["effects"] * total - (nothing - alone)
    wanted = (nothing - tuned + alone) / 2 / total
    assert shares["parameters"] == pytest.approx(wanted, abs=0.02)
    # What the brush leaves of a zero of 200 N: it takes up some, and never adds to it.
    assert 0.3 < tuned / (size * 4000) ** 2 < 1.05


def answered(trial, status="named", off=0.0, wrong=0.0, std=1.0):
    label = trial.label
    effects = label["effects"] if status == "named" else []
    shares = label["budget"]
    parts = [
        {"part": p, "share": shares[p] + wrong} for p in ("parameters", "unexplained", "noise")
    ]
    parts += [{"part": e, "share": shares["effects"] + wrong} for e in effects]
    return {
        "verdict": {
            "status": status,
            "effects": effects,
            "probability": 0.9,
            "also_possible": [],
            "parameters": {
                name: {"measured": about["true"] + off * std, "std": std}
                for name, about in label["parameters"].items()
            },
        },
        "candidates": [],
        "budget": parts,
    }


def test_intervals_and_shares_agree_with_hand_calculation(beside):
    trial = next(t for t in beside if t.label["of"] == "null")
    inside = judge("t", trial.label, answered(trial, "none", 1.64, 0.03))
    outside = judge("t", trial.label, answered(trial, "none", -1.65))
    assert inside.within == (True, True) and outside.within == (False, False)
    assert inside.shares_off == pytest.approx((0.03, 0.03))
    assert inside.right and not inside.flagged  # parameters are no effect


def test_a_share_of_another_effect_is_not_credited(beside):
    trial = next(t for t in beside if t.label["of"] == "singles")
    said = answered(trial)
    right = judge("t", trial.label, said)
    assert right.exact and max(right.shares_off) == pytest.approx(0)
    said["budget"][-1]["part"] = "conicity"
    wrong = judge("t", trial.label, said)
    assert wrong.shares_off[-1] == pytest.approx(trial.label["budget"]["effects"])


def test_parameters_scaled_by_an_effect_are_not_scored():
    made = drawn(513, 30)
    for trial in made:
        if trial.label["of"] != "singles":
            continue
        scales = {f.split(" x ")[0] for f in trial.label["families"]}
        said = trial.label["parameters"]
        if "friction" in scales:
            assert not said["mu"]["scored"]
        if "stiffness" in scales:
            assert not said["cpa2"]["scored"] and said["mu"]["scored"]
        if scales == {"measurement"}:
            assert said["mu"]["scored"] and said["cpa2"]["scored"]
