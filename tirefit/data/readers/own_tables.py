"""Recognise tables that tirefit wrote beside its results: :func:`own_table`."""

from collections.abc import Sequence

from tirefit.results import InputProblem

_TABLES = {
    frozenset(("segment", "first_line", "last_line", "kept")): (
        "the table of segments that tirefit prepare writes beside the rows to fit",
        "give NAME.csv, not NAME.segments.tsv",
    ),
    frozenset(("masked",)): (
        "the table of rows of tirefit diagnose: forces of models, not measurements",
        "give the file that was diagnosed, not NAME.rows.csv",
    ),
    frozenset(("controller", "seed", "stopping_distance")): (
        "the table of stops of tirefit brake",
        "give series.csv, which has every sample",
    ),
}
"""Headers -> what the table is, and the remedy."""


def own_table(headers: Sequence[str], file: str) -> InputProblem | None:
    """The problem that a file holds no measurements, as tirefit wrote it; None for others.

    Example:
        >>> print(own_table(["base_fy", "gap_fy", "masked"], "run.rows.csv").remedy)
        give the file that was diagnosed, not NAME.rows.csv
    """
    for own, (what, remedy) in _TABLES.items():
        if own <= set(headers):
            return InputProblem(f"this is {what}", remedy, file)
    return None
