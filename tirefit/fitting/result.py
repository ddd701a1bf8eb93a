"""The record of a fit, and ``fit.json`` (schema ``tirefit.fit/1``)."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from tirefit.data.accept import DataLike
from tirefit.data.records import frame
from tirefit.data.table import TireData
from tirefit.display import ByName, Figure, Record
from tirefit.door import sealed
from tirefit.files import json_safe, json_text
from tirefit.fitting.problem.layout import Layout
from tirefit.fitting.problem.likelihood import FitProblem
from tirefit.fitting.solve.far_rows import FarRow
from tirefit.fitting.solve.multistart import Solved
from tirefit.models import AbstractTire
from tirefit.params import parameter_values
from tirefit.results import Outcome, UsageError

if TYPE_CHECKING:
    import pandas
    import xarray

    from tirefit.fitting.store import StoredFit


SCHEMA = "tirefit.fit/1"
TRAJECTORY = "tirefit.trajectory/1"  # of tires fitted to trajectories of a car

_MOST_ROWS = 1000  # far rows in ``fit.json``, at most; ``data.set_aside`` counts all

_BELOW_MINUS_ONE = math.erfc(1 / math.sqrt(2)) / 2
"""Share of a Gaussian below its mean less one standard deviation."""


@dataclass(frozen=True)
class Estimate:
    """A number with its uncertainty: value, standard deviation, 95 % interval, unit.

    ``std`` and the ends of ``ci95`` are None where the data do not determine them. If a
    posterior was sampled, ``std`` is half the width of its central 68.27 %.
    """

    value: float
    std: float | None
    unit: str
    ci95: tuple[float | None, float | None]
    identified: bool = True
    fixed: bool = False

    @classmethod
    def of_draws(cls, draws: np.ndarray, unit: str, identified: bool) -> "Estimate":
        """The median and the central 95 % interval of finite posterior draws (m,).

        ``std`` is half the width of the central 68.27 %: the standard deviation of a
        Gaussian, which a few distant draws do not change.
        """
        shares = (0.025, _BELOW_MINUS_ONE, 0.5, 1 - _BELOW_MINUS_ONE, 0.975)
        low, left, median, right, high = np.quantile(draws, shares).tolist()
        std = (right - left) / 2 if identified else None
        return cls(median, std, unit, (low, high), identified)

    def times(self, factor: float, unit: str) -> "Estimate":
        """The estimate of ``factor`` times the number."""
        low, high = (None if end is None else factor * end for end in self.ci95)
        ci95 = (low, high) if factor > 0 else (high, low)
        std = None if self.std is None else abs(factor) * self.std
        return replace(self, value=factor * self.value, std=std, unit=unit, ci95=ci95)


@dataclass(frozen=True)
class FitStatistics:
    """How well the model describes the data."""

    rmse: float  # in the first force's unit
    r2: float
    chi2_dof: float | None
    aicc: float
    bic: float
    minus_two_log_likelihood: float
    unknowns: int
    n: int
    n_effective: float
    dof: float
    converged: bool
    at_bound: tuple[str, ...]
    starts: int
    starts_agreeing: int
    slip_structure: float


def information(
    minus_two_log: float, rows: int, effective: float, unknowns: int
) -> tuple[float, float]:
    """(AICc, BIC) of ``rows`` rows that count as ``effective`` independent ones.

    The log likelihood is scaled by ``effective / rows``. Models can be compared only if
    ``effective`` is the same for all of them.
    """
    share = effective / rows
    correction = 2 * unknowns * (unknowns + 1) / max(effective - unknowns - 1, 1)
    aicc = share * minus_two_log + 2 * unknowns + correction
    return aicc, share * minus_two_log + unknowns * math.log(max(effective, 1.0))


@dataclass(frozen=True)
class PosteriorSummary:
    """The record of a sampler; ``ess``, ``rhat`` and ``tau`` (in steps) are by label.
    ``importance`` has no chain, and therefore no ``rhat`` and no ``tau``."""

    sampler: str
    seed: int
    ensembles: int
    walkers: int
    steps: int  # ``importance``: number of points evaluated
    discarded: int
    ess: Mapping[str, float]
    rhat: Mapping[str, float]
    tau: Mapping[str, float]
    acceptance: float  # ``importance``: effective samples per point evaluated
    outcome: Outcome
    k_hat: float | None = None  # of the weights; ``emcee``: of the weights it replaced
    note: str = ""  # a further remark for the report


class PeakRange(NamedTuple):
    """Range of F_max / F_z over models of other shapes, if the peak depends on the shape.

    ``models`` holds the 95 % interval of each model that describes the rows as well as
    the best one; ``low`` and ``high`` are the ends of all of them. An end is None where
    the rows do not limit it. ``worse`` are the models that describe the rows worse.
    """

    low: float | None
    high: float | None
    share: float  # of the fitted peak that the rows reach
    models: Mapping[str, tuple[float | None, float | None]]
    worse: tuple[str, ...]


class Trial(NamedTuple):
    """A model whose force depends on a further column, tried on the rows of a fit."""

    column: str
    model: str
    against: str  # reason not to use it; empty if it is better
    aicc: tuple[float, ...]
    """AICc of the model of the fit and of this model, at one number of independent rows."""

    @property
    def better(self) -> bool:
        """Whether it has a clearly lower AICc and stops at no bound."""
        return not self.against


class Verdict(NamedTuple):
    """What a fit is worth: its outcomes; the sentences on it, that of the gravest
    outcome first; and by label where the routes to an interval differ."""

    outcomes: tuple[Outcome, ...] = ()
    sentences: tuple[str, ...] = ()
    disagreements: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, repr=False)
class FitResult(Record):
    """The result of a fit: its data and settings, the estimates and the verdict.

    ``parameters`` and ``derived`` come from the posterior if it was sampled, else from
    least squares and the profile; ``source`` says which. ``intervals`` holds those of
    all three routes (``covariance``, ``profile``, ``posterior``). ``far_rows``
    (``far_rows.FarRow``) are the outliers, excluded or kept.
    ``chains`` (ensembles, draws, p) are posterior samples of the free parameters in the
    order of ``labels``, thinned to be nearly independent; ``walkers`` the same draws as
    (ensembles, walkers, steps, p); ``z`` and ``covariance`` describe the estimate in
    the unconstrained space.
    """

    html_by: ClassVar[str] = "tirefit.report.fit.report:fit_fragment"
    text_by: ClassVar[str] = "tirefit.report.fit.report:fit_report"
    plot_by: ClassVar[str] = "tirefit.report.fit.figures:plot_fit"
    page_by: ClassVar[str] = "tirefit.report.fit.report:fit_page"
    save_by: ClassVar[str] = "tirefit.fitting.store:save_fit"

    model: str
    forces: tuple[str, ...]
    parameters: dict[str, Estimate]
    least_squares: dict[str, Estimate]
    intervals: dict[str, dict[str, tuple[float | None, float | None]]]
    derived: dict[str, Estimate]
    statistics: FitStatistics
    noise: dict[str, Any]
    verdict: Verdict
    labels: tuple[str, ...]
    correlation: np.ndarray
    data: dict[str, Any]
    reference: dict[str, float]
    solver: str
    seed: int
    version: str
    versions: dict[str, str]
    z: np.ndarray
    covariance: np.ndarray
    profiles: dict[str, dict[str, np.ndarray]]
    problem: FitProblem
    solved: Solved
    table: TireData
    far_rows: tuple[FarRow, ...] = ()
    peak_range: dict[str, PeakRange] = field(default_factory=dict)
    """By label of ``derived``, of each peak that depends on the shape of the model."""
    trials: tuple[Trial, ...] = ()
    posterior: PosteriorSummary | None = None
    asked: str = ""
    """Digest of the command's data and options, from which a rerun sees what is done."""
    interrupted: bool = False
    """Whether sampling was interrupted before it had anything to keep."""
    chains: np.ndarray | None = field(default=None, repr=False)
    walkers: np.ndarray | None = field(default=None, repr=False)

    internal: ClassVar[tuple[str, ...]] = (
        "asked",
        "problem",
        "solved",
        "walkers",
        "files",
        "limits",
    )

    def __post_init__(self) -> None:
        for name in ("parameters", "least_squares", "derived"):
            object.__setattr__(self, name, ByName(getattr(self, name)))

    def __repr__(self) -> str:
        return f"FitResult({self.model!r}, {self.data['file']!r}, {str(self.status)!r})"

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """What limits the use of the fit, in the order of the sentences."""
        return self.verdict.outcomes

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences of the verdict, that of the status first."""
        return self.verdict.sentences

    @property
    def source(self) -> str:
        """How the values and intervals of ``parameters`` and ``derived`` were obtained."""
        if self.posterior is not None:
            return "posterior median and central 95 %"
        return "least squares, profile likelihood"

    @property
    def samples(self) -> "xarray.Dataset":
        """The posterior samples by parameter, each (chain, draw), as an xarray Dataset.

        Any ArviZ takes it: ``arviz.summary(fit.samples)``. ``posterior.nc`` has the rows too.

        Raises:
            UsageError: the fit was not sampled.

        Example:
            >>> swept = simulate("rig", values={"mu": 0.9}, seed=1)
            >>> found = sample(fit(swept.columns, "brush"))
            >>> bool(abs(found.samples["mu"].mean() - 0.9) < 0.01)
            True
        """
        from tirefit.fitting.store import posterior_tree  # it imports this module

        if self.walkers is None:
            raise UsageError("the fit was not sampled", "samples = tirefit.sample(fit).samples")
        return posterior_tree(self)["posterior"].to_dataset()

    def predict(self, data: DataLike) -> dict[str, np.ndarray]:
        """Forces row by row with their standard deviations, as :func:`tirefit.predict`.

        Args:
            data: rows with slip, load and, where the model needs it, speed.

        Returns:
            (n,) arrays of each fitted force and of its ``<force>_std``.

        Example:
            >>> swept = simulate("rig", values={"mu": 0.9}, seed=1)
            >>> found = fit(swept.columns, "brush")
            >>> found.predict({"sigma_x": [0.5], "fz": [4000.0]})["fx"].round(-1)
            array([3600.])
        """
        from tirefit.fitting.predict import predict  # it imports this module

        return predict(self, data)

    @property
    def stored(self) -> "StoredFit":
        """The fit in the form of one read from a file, for predictions."""
        from tirefit.fitting.store import StoredFit  # it imports this module

        noise = {force: self.noise[force] for force in self.forces}
        content = {"reference": self.reference, "data": self.data}
        tire, layout = self.problem.model, self.problem.layout
        return StoredFit(self.model, tire, layout, self.z, self.covariance, noise, content)

    def to_frame(self) -> "pandas.DataFrame":
        """The parameters, derived values and statistics as a pandas data frame: columns kind,
        name, value, std, low and high (95 % interval), unit, identified.

        Example:
            >>> found = fit(samples / "circles.csv", "brush")
            >>> found.to_frame().query("kind == 'parameter'")["name"].tolist()
            ['cpa2', 'mu']
        """
        from tirefit.fitting.store import record_of_fit  # it imports this module

        return frame(record_of_fit(self.to_dict(), "").rows)

    def plot(self, what: str = "fit", **how: Any) -> Figure:
        """Return a figure of the measured points with the fitted curve, or another one.

        Args:
            what: ``fit``, ``residuals``, ``profile``, ``corner``, ``trace``, ``runs``.
            how: for ``fit``, ``ax``: axes of your own figure; for ``corner`` and
                ``trace``, ``parameters``: those to draw, by label or by name.

        Raises:
            UsageError: no such figure, or the fit does not have what it shows.
        """
        return super().plot(what, **how)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able content of ``fit.json``; no NaN, no infinity (they become null)."""
        content = {
            "schema": SCHEMA,
            "version": self.version,
            "versions": self.versions,
            "model": self.model,
            "forces": list(self.forces),
            "data": self.data,
            "noise": self.noise,
            "far_rows": [asdict(row) for row in self.far_rows[:_MOST_ROWS]],
            "solver": self.solver,
            "seed": self.seed,
            "source": self.source,
            "parameters": {k: asdict(v) for k, v in self.parameters.items()},
            "least_squares": {k: asdict(v) for k, v in self.least_squares.items()},
            "intervals": self.intervals,
            "derived": {k: asdict(v) for k, v in self.derived.items()},
            "peak_range": {k: v._asdict() for k, v in self.peak_range.items()},
            "trials": [trial._asdict() for trial in self.trials],
            "reference": self.reference,
            "correlation": {"labels": list(self.labels), "matrix": self.correlation},
            "fit": asdict(self.statistics),
            "posterior": None if self.posterior is None else asdict(self.posterior),
            "prediction": {
                "labels": list(self.labels),
                "z": self.z,
                "covariance": self.covariance,
                "layout": layout_record(self.problem.layout, self.problem.model),
            },
            "verdict": {
                "status": str(self.status),
                "sentences": self.warnings,
                "disagreements": self.verdict.disagreements,
            },
            "outcomes": self.outcomes,
        }
        if self.asked:
            content["asked"] = self.asked
        return json_safe(content)

    def to_json(self) -> str:
        """Text of ``fit.json``, with a checksum."""
        return json_text(sealed(self.to_dict()))


def layout_record(layout: Layout, model: AbstractTire) -> dict[str, Any]:
    """The record of a layout in ``fit.json``, from which ``predict`` rebuilds it.

    Args:
        model: holds the values of the fixed parameters.
    """
    free = {p.name for p in layout.free}
    return {
        "free": [
            {"name": p.name, "per_run": p.per_run, "lower": p.spec.lower, "upper": p.spec.upper}
            for p in layout.free
        ],
        "ties": [asdict(tie) for tie in layout.ties],
        "runs": list(layout.runs),
        "fixed": {
            name: float(value)
            for name, value in parameter_values(model).items()
            if name not in free
        },
    }
