"""Every effect of the library, in data written by other formulas: NumPy and SciPy by the
closed brush, or the bristles of ``fits.withheld.patch``. A refit must recover the amplitude
with its sign: every term, factor and unit of a ``change`` counts."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from conftest_diagnosis import brush
from scipy.integrate import solve_ivp

from fits.withheld.patch import World, forces
from tirefit.data.read import read_frame
from tirefit.diagnosis.effects import EFFECTS, atoms_of, effects_by_id
from tirefit.diagnosis.effects.tire import STEPS
from tirefit.diagnosis.engine.fit import Start
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.runs import offsets_of_runs
from tirefit.diagnosis.rows.subject import fit_base

KNOWN = effects_by_id(EFFECTS)
C, MU, G, RADIUS = 5e4, 0.9, 9.80665, 0.3
RATE = 0.05  # s between rows
BLOCKS = [(fz, v) for fz in (3000.0, 4000.0, 5000.0) for v in (8.0, 20.0)]
RIG = Rig(noise={"fx": 3.0, "fy": 3.0, "sigma_x": 1e-6, "alpha": 1e-6}, rolling_radius=RADIUS)


@dataclass
class Drive:
    """Six sweeps of the slip, at three loads and two speeds, 2 s apart: (n,) each."""

    t: np.ndarray
    own: np.ndarray  # time since the start of the sweep
    fz: np.ndarray
    v: np.ndarray
    block: np.ndarray
    s: np.ndarray

    @property
    def tau(self):
        """Time over the record, about its mean."""
        return over_range(self.t)

    @property
    def load(self):
        """Load over its mean."""
        return self.fz / np.mean(self.fz)

    @property
    def cruise(self):
        return np.exp(np.mean(np.log(self.v)))

    @property
    def sliding(self):
        """Speed of the sliding bristles of a wheel of driven or braked slip [m/s]."""
        return np.abs(self.v * self.s / (1 + self.s))


def over_range(x):
    return (x - np.mean(x)) / np.ptp(x)


def slip_at(own):
    """The slip of a sweep (two periods of 1 s, of both signs), at rest before it."""
    return 0.22 * np.sin(2 * np.pi * own) * (own > 0)


@cache
def drive():
    own = np.tile(np.arange(40) * RATE, len(BLOCKS))
    block = np.repeat(np.arange(len(BLOCKS)), 40)
    fz, v = np.array(BLOCKS)[block].T
    return Drive(own + 4.0 * block, own, fz, v, block, slip_at(own))


def force(w, slip=None, fz=None, mu=MU, c=C):
    return brush(w.s if slip is None else slip, c, mu, w.fz if fz is None else fz)


def patch(w, **of_tire):
    """Force of the bristles of a tire with other properties."""
    world = World(w.t, w.block, w.s, w.fz, w.v, "fx", C, MU)
    for name, value in of_tire.items():
        setattr(world, name, value)
    return forces(world)["fx"]


def by_sweep(w, make):
    """Values of each sweep in turn: make(time since its start, its speed)."""
    parts = [make(w.own[w.block == k], v) for k, (_, v) in enumerate(BLOCKS)]
    return np.concatenate(parts)


def lagged(own, values_at, constant):
    """First-order lag with a time constant [s], by SciPy, from rest."""
    made = solve_ivp(
        lambda t, y: (values_at(t) - y) / constant,
        (0.0, own[-1]), [float(values_at(0.0))], t_eval=own, max_step=0.005, rtol=1e-8,
    )  # fmt: skip
    return made.y[0]


def lagged_force(w, constant_of):
    """The force behind by a lag with the time constant constant_of(speed)."""
    every = [
        lagged(w.own[:40], lambda t, fz=fz: float(brush(slip_at(t), C, MU, fz)), constant_of(v))
        for fz, v in BLOCKS
    ]
    return np.concatenate(every)


def swing(w, rate):
    """A signal of the car [-] that is no function of the slip."""
    return np.sin(rate * w.t + 0.4)


def direction(w):
    """Sign of the rate of the slip."""
    return np.sign(np.cos(2 * np.pi * w.own))


def shifting(d):
    def shifting_pressure(xi, used):
        return 0.75 * (1 - xi**2) * (1 + d * used * xi)

    return shifting_pressure


def work(w):
    """Work of sliding so far over its range; nothing is done in a pause."""
    power = np.abs(force(w)) * w.sliding
    done = np.zeros(len(power))
    for k in range(1, len(done)):
        pause = w.block[k] != w.block[k - 1]
        done[k] = done[k - 1] + (0 if pause else 0.5 * RATE * (power[k] + power[k - 1]))
    return over_range(done)


def settling(w, constant):
    """A drift that is fast at first; zero at the middle of the record."""
    return 0.5 - np.exp(-(w.tau - w.tau.min()) / constant)


def steer(time):
    return 0.1 * np.sin(1.7 * time + 0.4)


def steered(turn):
    """The slip angle where the wheels turn by ``turn(w, a)`` less than logged."""
    return lambda w, a: force(w, np.tan(np.arctan(w.s) + turn(w, a)))


def late_steering(w, a):
    return steer(w.t) - steer(w.t - a)


def lagging_steering(w, a):
    """The lag of the steering, which turned before the sweeps too: exact for a sine."""
    omega = 1.7
    phase = np.arctan(omega * a)
    return steer(w.t) - np.cos(phase) * steer(w.t - phase / omega)


def fastest(w):
    """Sliding speed over the largest one of the file (95 %)."""
    return w.sliding / np.quantile(w.sliding, 0.95)


def speed_law(w, a, v_st, exponent):
    """S(37) of friction at all."""
    return MU * (1 - a * (1 - np.exp(-((fastest(w) / v_st) ** exponent))))


OFFSETS = np.array([-0.004, 0.001, 0.005, -0.003, 0.003, -0.002])
"""Differences of six runs, of zero mean."""
RMS = float(np.sqrt(np.mean(OFFSETS**2)))

TRUTHS = {
    # id: (amplitude, force with the effect) of each variant
    "slip_offset": [(0.004, lambda w, a: force(w, w.s + a))],
    "force_offset": [(15.0, lambda w, a: force(w) + 1e-3 * a * 4000)],
    "slip_definition": [
        (1.0, lambda w, a: force(w, w.s / (1 - a * w.s))),
        (1.0, lambda w, a: force(w, w.s / (1 + a * w.s))),
    ],
    "slip_zero_drift": [
        (0.006, lambda w, a: force(w, w.s + a * w.tau)),
        (0.006, lambda w, a: force(w, w.s + a * settling(w, 0.2))),
    ],
    "force_zero_drift": [
        (-20.0, lambda w, a: force(w) + 1e-3 * a * 4000 * w.tau),
        (20.0, lambda w, a: force(w) + 1e-3 * a * 4000 * settling(w, 0.2)),
    ],
    "load_crosstalk": [(15.0, lambda w, a: force(w) + 1e-3 * a * w.fz)],
    "load_offset": [(40.0, lambda w, a: force(w, fz=w.fz + 1e-3 * a * 4000))],
    "force_crosstalk": [(0.03, lambda w, a: force(w) + a * 1500 * swing(w, 1.9))],
    "force_hysteresis": [
        (10.0, lambda w, a: force(w) + 1e-3 * a * 4000 * direction(w)),
        (10.0, lambda w, a: (
            force(w) + 1e-3 * a * 4000 * direction(w) * np.abs(force(w)) / (MU * w.fz)
        )),
    ],
    "slip_offset_load": [
        (0.01, lambda w, a: force(w, w.s + a * (w.load - 1))),
        (-0.01, lambda w, a: force(w, w.s + a * w.load)),
    ],
    "slip_offset_speed": [
        (3e-4, lambda w, a: force(w, w.s + a * w.v)),
        (-3e-4, lambda w, a: force(w, w.s + a * w.v**2 / w.cruise)),
        (5e-4, lambda w, a: force(w, w.s + a * (w.v - w.cruise))),
        (3e-4, lambda w, a: force(w, w.s + a * (w.v**2 / w.cruise - w.cruise))),
    ],
    "speed_zero": [(0.05, lambda w, a: force(w, w.s + a / w.v))],
    "speed_drag": [
        (15.0, lambda w, a: force(w) + 1e-3 * a * 4000 * w.v / w.cruise),
        (15.0, lambda w, a: force(w) + 1e-3 * a * 4000 * (w.v / w.cruise) ** 2),
    ],
    "friction_ellipse": [
        (0.9, lambda w, a: force(w, mu=MU * np.sqrt(1 - a * (used(w)) ** 2))),
        (0.9, lambda w, a: force(w) * np.sqrt(1 - a * (used(w)) ** 2)),
    ],
    "load_transfer": [(0.08, lambda w, a: force(w, fz=w.fz + a * 4000 * over_range(
        swing(w, 0.9))))],
    "wheel_inertia": [(1.4, lambda w, a: force(w) - a * spin_up(w) / RADIUS)],
    "channel_delay": [
        (0.03, lambda w, a: by_sweep_force(w, lambda own, v: slip_at(own - a))),
        (0.03, lambda w, a: by_sweep_force(w, lambda own, v: slip_at(own - a))),
        (0.03, lambda w, a: lagged_force(w, lambda v: a)),
    ],
    "relaxation_length": [
        (0.4, lambda w, a: by_sweep_force(w, lambda own, v: lagged(own, slip_at, a / v))),
        (0.4, lambda w, a: lagged_force(w, lambda v: a / v)),
    ],
    "friction_step": [
        (0.1, lambda w, a: force(w, mu=MU * (1 + a * np.where(w.tau > STEPS[9], 0.5, -0.5)))),
    ],
    "friction_drift": [
        (0.1, lambda w, a: force(w, mu=MU * (1 + a * w.tau))),
        (-0.1, lambda w, a: force(w, mu=MU * (1 + a * settling(w, 0.12)))),
        (0.1, lambda w, a: force(w, mu=MU * (1 + a * settling(w, 0.35)))),
    ],
    "stiffness_drift": [
        (0.15, lambda w, a: force(w, c=C * (1 + a * w.tau))),
        (-0.15, lambda w, a: force(w, c=C * (1 + a * settling(w, 0.12)))),
    ],
    "friction_temperature": [(-0.1, lambda w, a: force(w, mu=MU * (1 + a * heat(w) / 20)))],
    "stiffness_temperature": [(-0.15, lambda w, a: force(w, c=C * (1 + a * heat(w) / 20)))],
    "friction_pressure": [(0.1, lambda w, a: force(w, mu=MU * (1 + a * over_range(heat(w)))))],
    "stiffness_pressure": [(-0.15, lambda w, a: force(w, c=C * (1 + a * over_range(heat(w)))))],
    "friction_warming": [(-0.1, lambda w, a: force(w, mu=MU * (1 + a * work(w))))],
    "stiffness_warming": [(-0.15, lambda w, a: force(w, c=C * (1 + a * work(w))))],
    "friction_hysteresis": [
        (0.05, lambda w, a: force(w, mu=MU * (1 + a / 2 * direction(w) * np.sign(w.s)))),
    ],
    "drive_brake_asymmetry": [(0.1, lambda w, a: force(w, mu=MU * (1 + a / 2 * np.sign(w.s))))],
    "load_friction": [
        (-0.15, lambda w, a: force(w, mu=MU * w.load**a)),
        (-0.15, lambda w, a: force(w, mu=MU * (1 + a * (w.load - 1)))),
        (-0.15, lambda w, a: force(w, mu=MU * (1 + a * np.log(w.load)))),
    ],
    "load_stiffness": [
        (0.6, lambda w, a: force(w, c=C * w.load**a)),
        (0.6, lambda w, a: force(w, c=C * (1 + a * (w.load - 1)))),
        (0.6, lambda w, a: force(w, c=C * (1 + a * np.log(w.load)))),
    ],
    "friction_speed_linear": [
        (0.02, lambda w, a: patch(w, mu_k=MU * (1 - a * w.sliding))),
        (0.02, lambda w, a: force(w, mu=MU * (1 - a * w.sliding))),
        (0.005, lambda w, a: force(w, mu=MU * (1 - a * w.v))),
    ],
    "friction_speed_exponential": [
        (0.15, lambda w, a: patch(w, mu_k=speed_law(w, a, 0.15, 1.0))),
        *[(0.15, None)] * 5,
        (0.15, lambda w, a: force(w, mu=speed_law(w, a, 0.15, 1.0))),
        (-0.15, lambda w, a: force(w, mu=speed_law(w, a, 0.6, 1.0))),
        (0.15, lambda w, a: force(w, mu=speed_law(w, a, 0.6, 0.5))),
        (0.15, None),
        (0.15, None),
        (0.15, lambda w, a: force(w, mu=MU * (1 - a * np.log1p(fastest(w) / 0.1) / np.log(11)))),
    ],
    "kinetic_friction": [(0.2, lambda w, a: patch(w, mu_s=MU * (1 + a) * np.ones(240)))],
    "pressure_asymmetry": [(0.25, lambda w, a: patch(w, pressure=lambda xi, used: (
        0.75 * (1 - xi**2) * (1 + a * xi))))],
    "pressure_flatness": [(0.5, lambda w, a: patch(w, pressure=lambda xi, used: (
        (1 - a) * 0.75 * (1 - xi**2) + a * 0.625 * (1 - xi**4))))],
    "pressure_shift_load": [(0.2, lambda w, a: patch(w, pressure=shifting(a)))],
    "carcass_flexibility": [(0.01, lambda w, a: patch(w, carcass=(a / 4000, "slip")))],
    "stiffness_speed": [(0.15, lambda w, a: force(w, c=C * (w.v / w.cruise) ** a))],
    "combined_slip": [(0.8, lambda w, a: (
        force(w, np.hypot(w.s, a * cross(w))) * w.s / np.hypot(w.s, a * cross(w))
    ))],
    "slip_offset_run": [(RMS, lambda w, a: force(w, w.s + OFFSETS[w.block]))],
    "force_offset_run": [(4e3 * RMS, lambda w, a: force(w) + 4 * 4e3 * OFFSETS[w.block])],
    "friction_run": [(20 * RMS, lambda w, a: force(w, mu=MU * np.exp(20 * OFFSETS[w.block])))],
    "stiffness_run": [(30 * RMS, lambda w, a: force(w, c=C * np.exp(30 * OFFSETS[w.block])))],
    "tracked_point": [(0.15, lambda w, a: force(w, w.s + a * 0.6 * swing(w, 1.7) / w.v))],
    "toe": [(0.008, lambda w, a: force(w, w.s + a * lean(w)))],
    "lateral_load_transfer": [
        (0.15, lambda w, a: force(w, mu=MU * (1 - a * lean(w) ** 2))),
        (0.15, lambda w, a: force(w, c=C * (1 - a * lean(w) ** 2))),
        (0.15, lambda w, a: force(w) * (1 - a * lean(w) ** 2)),
    ],
    "unlike_tires": [
        (0.08, lambda w, a: force(w, mu=MU * (1 + a * lean(w)))),
        (-0.08, lambda w, a: force(w, c=C * (1 + a * lean(w)))),
        (0.08, lambda w, a: force(w) * (1 + a * lean(w))),
    ],
    "steering_gain": [(0.1, lambda w, a: force(w, w.s + a * steer(w.t)))],
    "steering_delay": [(0.1, steered(late_steering))],
    "steering_lag": [(0.1, steered(lagging_steering))],
    "yaw_inertia": [(60.0, lambda w, a: force(w) + a * 2.5 * swing(w, 1.7))],
    "floor_slope": [
        (0.01, lambda w, a, k=k: force(w) + a * w.fz * np.cos(turned(w) - np.radians(45 * k)))
        for k in range(4)
    ],
    "camber_thrust": [
        (0.2, lambda w, a: force(w, w.s + a * 0.05 * swing(w, 1.3))),
        (0.1, lambda w, a: force(w) + 10 * a * 0.05 * swing(w, 1.3) * w.fz),
    ],
    "conicity": [(-15.0, lambda w, a: force(w) + 1e-3 * a * w.fz)],
}  # fmt: skip


def used(w):
    """Share of the friction that the other force uses."""
    return 1500 * swing(w, 1.9) / (MU * w.fz)


def by_sweep_force(w, slip_of):
    return force(w, by_sweep(w, slip_of))


def spin_up(w):
    """d omega / dt of omega = v / (R (1 + s)), with the analytic rate of the slip."""
    rate = 0.22 * 2 * np.pi * np.cos(2 * np.pi * w.own)
    return -w.v / RADIUS * rate / (1 + w.s) ** 2


def heat(w):
    return 10 * swing(w, 0.5) - np.mean(10 * swing(w, 0.5))


def cross(w):
    """The other slip: tan(alpha) (1 + sigma_x)."""
    return 0.06 * swing(w, 1.1) * (1 + w.s)


def lean(w):
    return 0.6 * swing(w, 2.3)


def turned(w):
    return 0.35 * w.t


NEEDED = {
    "force_crosstalk": lambda w: {"fy": 1500 * swing(w, 1.9)},
    "friction_ellipse": lambda w: {"fy": 1500 * swing(w, 1.9)},
    "load_transfer": lambda w: {"a_x": 3 * swing(w, 0.9)},
    "wheel_inertia": lambda w: {"omega": w.v / RADIUS / (1 + w.s)},
    "friction_temperature": lambda w: {"temperature": 40 + heat(w)},
    "stiffness_temperature": lambda w: {"temperature": 40 + heat(w)},
    "friction_pressure": lambda w: {"pressure": 2.2e5 + 2e3 * heat(w)},
    "stiffness_pressure": lambda w: {"pressure": 2.2e5 + 2e3 * heat(w)},
    "combined_slip": lambda w: {"alpha": np.arctan(0.06 * swing(w, 1.1))},
    "tracked_point": lambda w: {"yaw_rate": 0.6 * swing(w, 1.7)},
    "yaw_inertia": lambda w: {"yaw_acceleration": 2.5 * swing(w, 1.7)},
    "floor_slope": lambda w: {"heading": turned(w)},
    "camber_thrust": lambda w: {"gamma": 0.05 * swing(w, 1.3)},
    "toe": lambda w: {"a_y": G * lean(w)},
    "lateral_load_transfer": lambda w: {"a_y": G * lean(w)},
    "unlike_tires": lambda w: {"a_y": G * lean(w)},
    "steering_gain": lambda w: {"steering": steer(w.t)},
    "steering_delay": lambda w: {"steering": steer(w.t)},
    "steering_lag": lambda w: {"steering": steer(w.t)},
}
"""Further columns of the file."""

LATERAL = {
    "tracked_point", "yaw_inertia", "floor_slope", "camber_thrust", "toe", "conicity",
    "lateral_load_transfer", "unlike_tires", "steering_gain", "steering_delay", "steering_lag",
}  # fmt: skip
EXACT = 0.02
"""Tolerance of an amplitude: the prior pulls by its part of the information, and the noise
is not zero for the refit."""
WIDER = {
    # The force of the base model stands in for the true one, to first order.
    "carcass_flexibility": 0.1,
    "pressure_shift_load": 0.1,
    # The slip between rows is interpolated, and a sweep begins with a bend; a filter acts
    # on the force of the base model.
    "channel_delay": 0.06,
    "relaxation_length": 0.06,
    "channel_delay-2": 0.15,
    "relaxation_length-1": 0.15,
    "steering_delay": 0.04,
    "steering_lag": 0.06,
    "wheel_inertia": 0.06,
    # The largest force over load stands in for mu; the turning points are estimated.
    "friction_ellipse": 0.06,
    "force_hysteresis": 0.06,
    "friction_hysteresis": 0.06,
    # By the measured force, which has the effect.
    "friction_warming": 0.05,
    # A plain fit leaves much of it as noise, and the prior pulls.
    "friction_pressure": 0.06,
    "unlike_tires": 0.06,
    # 128 bristles.
    "kinetic_friction": 0.04,
    "pressure_asymmetry": 0.04,
    "pressure_flatness": 0.04,
    # The pattern of the runs comes from the plain fit.
    "slip_offset_run": 0.06,
    "force_offset_run": 0.06,
    "friction_run": 0.06,
    "stiffness_run": 0.15,
}


LEFT = {
    # At turning points, whose place is estimated.
    "force_hysteresis-0": 0.4,
    "force_hysteresis-1": 0.4,
    "friction_hysteresis-0": 0.4,
    # A filter acts on the force of the base model; the pattern comes from the plain fit.
    "channel_delay-2": 0.3,
    "relaxation_length-1": 0.3,
    "stiffness_run-0": 0.2,
    # The angle before a sweep is not known; there the force is steep.
    "steering_delay-0": 0.55,
    "steering_lag-0": 0.55,
}
"""Largest share of an effect that its refit leaves, instead of a twentieth."""


def refitted(id, variant, made):
    """The base, and a variant refitted to a force (n,) beside stiffness and friction."""
    w, lateral = drive(), id in LATERAL
    frame = {"time": w.t, "fz": w.fz, "v": w.v}
    if lateral:
        frame |= {"alpha": np.arctan(w.s), "fy": made}
    else:
        frame |= {"sigma_x": w.s, "fx": made}
    if id.endswith("_run"):
        frame["run"] = np.array([f"r{k}" for k in w.block])
    data = read_frame(frame)
    more = NEEDED.get(id, lambda w: {})(w)
    data = replace(data, columns={**data.columns, **more})
    channel = "fy" if lateral else "fx"
    base = fit_base(prepare(data, RIG, (channel,)), "brush", [KNOWN[id]], RIG)
    prior = base.priors
    usual = prior.center[variant] or 0.3
    starts = [Start(base.z, np.array([sign * usual])) for sign in (1.0, -1.0)]
    fits = base.refit(starts, [(variant,)] * 2)
    return base, max(fits, key=lambda fit: fit.log_evidence)


OFTEN = {
    "slip_offset", "load_crosstalk", "load_friction", "friction_drift", "stiffness_speed",
    "friction_ellipse", "pressure_asymmetry", "kinetic_friction", "tracked_point", "toe",
    "floor_slope", "camber_thrust", "steering_delay", "relaxation_length", "wheel_inertia",
    "friction_warming", "friction_run", "slip_definition", "speed_zero",
}  # fmt: skip
"""One of each kind, of which the first variant is tested always."""
CASES = [
    pytest.param(
        id,
        variant,
        *case,
        id=f"{id}-{variant}",
        marks=[] if id in OFTEN and variant == 0 else pytest.mark.long,
    )
    for id, cases in TRUTHS.items()
    for variant, case in enumerate(cases)
    if case[1] is not None
]


def test_every_effect_has_its_truth():
    assert set(TRUTHS) == {effect.id for effect in EFFECTS}
    assert all(len(cases) <= len(KNOWN[id].variants) for id, cases in TRUTHS.items())


@pytest.mark.parametrize(("id", "variant", "amplitude", "truth"), CASES)
def test_the_amplitude_of_an_effect_is_recovered(id, variant, amplitude, truth):
    if id == "friction_step":
        (variant,) = [
            k for k, atom in enumerate(atoms_of([KNOWN[id]])) if atom.constants == (STEPS[9], 1.0)
        ]
    made = truth(drive(), amplitude)
    # The effect is well above the noise of 3 N, so that its sign is not by chance.
    size = np.sqrt(np.mean((made - force(drive())) ** 2))
    assert size > 10
    tolerance = WIDER.get(f"{id}-{variant}", WIDER.get(id, EXACT))
    base, fit = refitted(id, variant, made)
    amplitudes = base.amplitudes(fit.atoms, fit.amplitude)
    assert amplitudes[variant] == pytest.approx(amplitude, rel=tolerance)
    # A term that is missing, of the load for instance, need not change the amplitude.
    (found,) = base.forces(fit.z, amplitudes).values()
    left = np.sqrt(np.mean((made - found) ** 2))
    assert left < LEFT.get(f"{id}-{variant}", 0.05) * size


def test_offsets_of_runs_are_found_in_newtons():
    made = force(drive()) + 16e3 * OFFSETS[drive().block]
    base, fit = refitted("force_offset_run", 0, made)
    found = offsets_of_runs(base, fit)["force_offset"]
    values = [value - found.common for value, _ in found.values.values()]
    np.testing.assert_allclose(values, 16e3 * OFFSETS, atol=3.0)
