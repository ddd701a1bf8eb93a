"""The listed effects as models of a file, for the baselines and for ``mimic_free``.

Textbook forms only, on the bristle patch of ``patch.py``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from fits.withheld.effects import EFFECTS
from fits.withheld.patch import World, forces, plain_brush

__all__ = [
    "Inputs",
    "STEP_TIMES",
    "base_fit",
    "mimic_free",
    "predict",
    "predict_together",
    "shapes",
    "spread",
    "plain_world",
]

STEP_TIMES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the range in which a road may change


@dataclass(frozen=True)
class Inputs:
    """Columns (n,) of a file, None if absent.

    ``slip`` is as logged; ``stds`` are those of slip [-], force [N] (n,) and
    moment [N m] (n,).
    """

    time: np.ndarray
    run: np.ndarray
    slip: np.ndarray
    fz: np.ndarray
    v: np.ndarray
    force: str
    stds: tuple
    cross: np.ndarray | None = None
    gamma: np.ndarray | None = None
    temperature: np.ndarray | None = None
    inflation: np.ndarray | None = None
    across: np.ndarray | None = None
    omega: bool = False
    moment: bool = False
    left_out: tuple[str, ...] = ()

    def without(self, effects) -> "Inputs":
        """The same data without these effects in the list."""
        return replace(self, left_out=tuple(effects))

    @property
    def properties(self) -> set[str]:
        """Properties that effects may need (``needs``)."""
        has = {
            "loads": np.ptp(self.fz) > 0.3 * self.fz.mean(),
            "speeds": np.ptp(self.v) > 0.3 * self.v.mean(),
            "signs": self.slip.min() < -0.02,
            "sweeps": np.corrcoef(self.slip[1:], self.slip[:-1])[0, 1] > 0.8,
            "knee": np.abs(self.slip).max() > 0.1,
            "longitudinal": self.force == "fx",
            "lateral": self.force == "fy",
            "alpha": self.cross is not None,
            "gamma": self.gamma is not None,
            "temperature": self.temperature is not None,
            "pressure": self.inflation is not None,
            "across": self.across is not None,
            "omega": self.omega,
        }
        return {name for name, holds in has.items() if holds}

    @property
    def effects(self) -> list[str]:
        """Effects that these columns and this design allow."""
        have = self.properties
        return [
            name
            for name, effect in EFFECTS.items()
            if effect.needs <= have and name not in self.left_out
        ]


class _Share:
    """Replaces a random generator: ``uniform`` returns this share of the range."""

    def __init__(self, share: float):
        self.share = share

    def uniform(self, low, high):
        return low + self.share * (high - low)


_UNDONE = ("slip_offset", "slip_definition")
"""Effects on the logged slip with an explicit inverse."""


def _slip_behind(world: World) -> np.ndarray:
    """The slip before the changes of its logging, to first order."""
    slip = world.slip
    for change in world.logged:
        slip = change(world, slip)
    return 2 * world.slip - slip


def _true_slip(effect: str, slip: np.ndarray, amplitude: float) -> np.ndarray:
    """The slip before logging (the inverse of the form's ``logged``)."""
    if effect == "slip_offset":
        return slip - amplitude
    if effect == "slip_definition":  # amplitude 1: kappa was logged as sigma
        return slip / (1 - np.clip(amplitude * slip, -0.9, 0.9))
    return slip


def predict(
    x: Inputs, effect: str | None, amplitude, c, mu, share=0.5, form: str = ""
) -> np.ndarray:
    """Force [N] (n,), followed by the moment [N m] if measured (2n,).

    ``form``: the textbook form by default; ``share`` replaces its random draws by this
    share of their range.
    """
    if effect is None:
        return _forces(x, x.slip, (), c, mu)
    textbook = next(iter(EFFECTS[effect].forms))
    part = (effect, form or textbook, amplitude, share)
    if effect in _UNDONE and part[1] == textbook:
        slip = _true_slip(effect, x.slip, amplitude)
        return _forces(x, slip, [part], c, mu, behind=False)
    return _forces(x, x.slip, [part], c, mu)


def predict_together(
    x: Inputs, parts: Sequence[tuple], c, mu, more: Callable[[World], object] | None = None
) -> np.ndarray:
    """The same for several (effect, form, amplitude, share) at once, and ``more``, a change of
    the world after them; changes of the logged slip are inverted to first order."""
    return _forces(x, x.slip, parts, c, mu, more=more)


def plain_world(x: Inputs, slip, c, mu) -> World:
    """A plain tire with these inputs."""
    return World(
        x.time, x.run, slip, x.fz, x.v, x.force, c, mu, cross=x.cross, gamma=x.gamma,
        temperature=x.temperature, inflation=x.inflation, across=x.across,
        moment=x.moment,
    )  # fmt: skip


def _forces(x: Inputs, slip, parts, c, mu, behind: bool = True, more=None) -> np.ndarray:
    world = plain_world(x, slip, c, mu)
    for effect, form, amplitude, share in parts:
        EFFECTS[effect].forms[form](world, amplitude, _Share(share))
    if more:
        more(world)
    if parts and behind:
        world.slip = _slip_behind(world)
    out = forces(world)
    return np.concatenate([out[x.force], out["mz"]]) if x.moment else out[x.force]


def spread(x: Inputs, c: float, mu: float) -> np.ndarray:
    """Standard deviation of force (and moment), including the noise of the slip."""
    slip_std, force_std, moment_std = x.stds
    step = 1e-4
    steep = [
        (ahead - behind) / (2 * step)
        for ahead, behind in zip(
            plain_brush(x.slip + step, x.fz, c, mu),
            plain_brush(x.slip - step, x.fz, c, mu),
            strict=True,
        )
    ]
    std = np.hypot(force_std, steep[0] * slip_std)
    if not x.moment:
        return std
    return np.concatenate([std, np.hypot(moment_std, steep[1] * slip_std)])


def base_fit(x: Inputs, observed: np.ndarray, c=5e4, mu=0.9, loss="linear"):
    """Least squares of the plain brush: (c, mu), standardised residuals, their std."""

    def model(p):
        force, moment = plain_brush(x.slip, x.fz, *np.exp(p))
        return np.concatenate([force, moment]) if x.moment else force

    start = np.log([c, mu])
    for _ in range(2):
        std = spread(x, *np.exp(start))
        found = least_squares(lambda p, std=std: (observed - model(p)) / std, start, loss=loss)
        start = found.x
    return np.exp(start), (observed - model(start)) / std, std


def directions(x: Inputs, c: float, mu: float) -> np.ndarray:
    """Change of the plain brush with log c and log mu, (n, 2)."""
    step = 1e-4
    return np.column_stack(
        [
            (
                predict(x, None, 0, c * np.exp(step), mu)
                - predict(x, None, 0, c * np.exp(-step), mu)
            ),
            (
                predict(x, None, 0, c, mu * np.exp(step))
                - predict(x, None, 0, c, mu * np.exp(-step))
            ),
        ]
    ) / (2 * step)


def shapes(x: Inputs, effects, c: float, mu: float) -> dict[str, list[np.ndarray]]:
    """Change of the forces by each effect of typical amplitude, not standardised."""
    plain = predict(x, None, 0, c, mu)
    return {
        effect: [
            predict(x, effect, EFFECTS[effect].typical, c, mu, share) - plain
            for share in (STEP_TIMES if effect == "friction_step" else (0.5,))
        ]
        for effect in effects
    }


def mimic_free(x: Inputs, truth: np.ndarray) -> float:
    """The part of a noise-free gap that no listed effect can fit, in standard errors.

    Each effect is fitted together with c and mu, as its shape at typical amplitude times
    a free factor.
    """
    (c, mu), misses, std = base_fit(x, truth)
    base = directions(x, c, mu) / std[:, None]
    rest = [np.linalg.norm(misses)]
    for shape in (s for some in shapes(x, x.effects, c, mu).values() for s in some):
        columns = np.column_stack([base, shape / std])
        scale = np.linalg.norm(columns, axis=0) + 1e-12
        best = np.linalg.lstsq(columns / scale, misses, rcond=None)[0]
        rest.append(np.linalg.norm(misses - columns / scale @ best))
    return round(float(min(rest)), 3)
