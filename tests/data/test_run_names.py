"""Short names of runs: distinct, short, and without loss."""

import numpy as np

from tirefit.data.run_names import LONGEST, clipped, name_pattern, run_names


def test_names_of_a_session_keep_only_what_differs():
    names = [f"drum_2026-03-12_cold_run{i:02d}_brake" for i in range(1, 15)]
    short, pattern = run_names(names)
    assert short == tuple(f"run{i:02d}" for i in range(1, 15))
    assert pattern == "drum_2026-03-12_cold_*_brake"
    assert [pattern.replace("*", own) for own in short] == names


def test_a_number_keeps_the_word_before_it():
    names = ["rig-2026-03-12-dry-asphalt", "rig-2026-03-13-dry-asphalt"]
    assert run_names(names) == (("03-12", "03-13"), "rig-2026-*-dry-asphalt")


def test_short_names_are_unchanged():
    assert run_names(["first", "second"]) == (("first", "second"), "")
    assert run_names(["a" * 40]) == (("a" * 40,), "")


def test_names_that_share_nothing_are_numbered():
    names = ["michelin_sport_monday_hot_track", "conti_contact_wet_tuesday_cold"]
    short, pattern = run_names(names)
    assert [one[:2] for one in short] == ["1:", "2:"] and pattern == ""


def test_shortened_names_stay_distinct():
    generator = np.random.default_rng(0)
    alphabet = list("ab1_-. [")

    def word():
        return "".join(generator.choice(alphabet, generator.integers(0, 30)))

    for _ in range(300):
        head, tail, count = word(), word(), generator.integers(1, 9)
        own = list({word()[: generator.integers(1, 30)] for _ in range(count)})
        check([f"{head}{one}{tail}" for one in own])


def check(names):
    short, pattern = run_names(names)
    assert len(set(short)) == len(names)
    if len(names) > 1:
        assert max(map(len, short)) <= LONGEST
    if pattern:
        first, last = pattern.split("*")
        assert [f"{first}{one}{last}" for one in short] == names


def test_file_names_are_shortened_to_a_pattern():
    assert name_pattern(["a_1.csv", "a_2.csv"]) == "*.csv"
    assert name_pattern(["monday.csv", "tuesday.csv"]) == "*.csv"
    assert name_pattern(["x.csv"]) == "x.csv"
    assert name_pattern(["monday", "tuesday"]) == "monday, tuesday"


def test_clipping_keeps_both_ends():
    assert clipped("abcdefghij", 5) == "ab…ij" and clipped("abc", 5) == "abc"


def test_bins_are_named_by_the_words_that_differ():
    bins = [
        f"{fz} N {gamma} deg {p} kPa {v} m/s"
        for fz in (222, 1112)
        for gamma in (-2, 0)
        for p in (82.6, 96.6)
        for v in (11,)
    ]
    short, pattern = run_names(bins)
    assert short[0] == "222 N -2 deg 82" and short[-1] == "1112 N 0 deg 96"
    assert len(set(short)) == len(bins) and pattern == "*.6 kPa 11 m/s"
