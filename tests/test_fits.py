"""Every case of ``fits/`` agrees with its expected.toml: a new case adds a test."""

import pytest
from fits_support import (
    CASES,
    all_checks,
    broken,
    derive_all,
    load,
    look_up,
    malformed,
    part_of,
    run_fit,
)

NAMES = [case.name for case in CASES]
QUICK = ("source_figures", "tire_sensor")
"""Run with the suite. The others take seconds to minutes: pages of the manual fit and
diagnose the same axle; other tests run the same models, estimators and simulations."""


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_expected_is_well_formed(case):
    expected = load(case)
    assert malformed(expected) == []
    assert all_checks(expected)
    assert (case / "README.md").exists()
    figures = list(case.glob("*.png"))
    assert figures
    assert max(path.stat().st_size for path in figures) < 120_000


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=case.name, marks=[pytest.mark.long] * (case.name not in QUICK))
        for case in CASES
    ],
)
def test_case(case, tmp_path):
    expected = load(case)
    reference = part_of(case, "reference", "reference")
    derive_all(case, expected, tmp_path)
    wrong = []
    for fit in expected.get("fit", []):
        content = run_fit(case, fit, tmp_path).to_dict()
        for check in fit["expect"]:
            found = look_up(content, check["of"])
            wrong += [f"{fit['name']}: {x}" for x in broken(check, found, reference)]
    numbers = part_of(case, "draw", "properties") if "number" in expected else {}
    for check in expected.get("number", []):
        wrong += broken(check, numbers[check["of"]], reference)
    assert wrong == [], "\n".join(wrong)
