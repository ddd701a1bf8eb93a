"""The gallery: figures, each with the command that makes it and the page that states it."""

FIGURES = (
    (
        "A fit with its bands",
        "fits/dart_rear_axle/fit.png",
        "fits/dart_rear_axle/README.md",
        "tirefit fit fits/dart_rear_axle/free_driving.csv"
        " --config fits/dart_rear_axle/fit.toml --out out/demo",
    ),
    (
        "Residuals against each input",
        "fits/notebooks/explore_a_fit_2.png",
        "fits/notebooks/explore_a_fit.md",
        'brush.plot("residuals")',
    ),
    (
        "Profile likelihood",
        "fits/notebooks/explore_a_fit_3.png",
        "fits/notebooks/explore_a_fit.md",
        'brush.plot("profile")',
    ),
    (
        "Posterior of each pair",
        "fits/notebooks/explore_a_fit_5.png",
        "fits/notebooks/explore_a_fit.md",
        'posterior.plot("corner")',
    ),
    (
        "A whole Magic Formula by load",
        "fits/rig_test/by_load.png",
        "fits/rig_test/README.md",
        "tirefit fit ready/cornering.csv ready/drive_brake.csv"
        " --config fits/rig_test/fit.toml --html --out fit",
    ),
    (
        "Its friction ellipse",
        "fits/rig_test/ellipse.png",
        "fits/rig_test/README.md",
        "tirefit fit ready/cornering.csv ready/drive_brake.csv"
        " --config fits/rig_test/fit.toml --html --out fit",
    ),
    (
        "How far a simulator's error shrinks",
        "fits/dart_simulator/ladder.png",
        "fits/dart_simulator/README.md",
        "tirefit diagnose fits/dart_simulator/free_driving.csv"
        " --model out/circles/fit.json --figures --out out/axle",
    ),
    (
        "A diagnosis",
        "fits/notebooks/diagnose_a_measured_case_1.png",
        "fits/notebooks/diagnose_a_measured_case.md",
        "found.plot()",
    ),
    (
        "An effect: without, with, difference",
        "docs/effects/relaxation_length.png",
        "docs/effects/README.md",
        "tirefit diagnose",
    ),
    (
        "A car's logs predicted, with the effects of a diagnosis",
        "fits/replay/with_effects.png",
        "fits/replay/README.md",
        "python -m fits.replay --only diagnosis --out out/replay",
    ),
    (
        "Predicted and measured over time",
        "fits/notebooks/predict_a_car_3.png",
        "fits/notebooks/predict_a_car.md",
        'replay.plot("series")',
    ),
    (
        "Friction while braking",
        "fits/friction_while_braking/friction.png",
        "fits/friction_while_braking/README.md",
        "tirefit estimate log.csv --method rls,mit,ekf --out out",
    ),
    (
        "Two controllers stop a car",
        "fits/braking/low_stop.png",
        "fits/braking/README.md",
        "make braking",
    ),
    (
        "One tire in three programs",
        "fits/export/forces_and_path.png",
        "fits/export/README.md",
        "tirefit export out/a_rear/fit.json --to casadi --out out/rear.py",
    ),
    (
        "How often intervals contain the truth",
        "fits/posterior_peers/coverage.png",
        "fits/posterior_peers/README.md",
        "make posterior-peers",
    ),
    (
        "Delay against false alarms",
        "fits/friction_benchmark/trade_off.png",
        "fits/friction_benchmark/README.md",
        "make friction-benchmark",
    ),
)
"""Title, figure, page and command; the page states the command."""


def text():
    """The cards of the gallery, as a list in Markdown."""
    return "\n".join(
        f"- [![{title}](../{figure})](../{page})\n\n    **{title}**"
        f" ([page](../{page}))\n\n    `{command}`\n"
        for title, figure, page, command in FIGURES
    )
