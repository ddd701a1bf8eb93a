"""States of rows on arrays of NumPy, against the same formulas differentiated by JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tirefit.diagnosis.effects import EFFECTS, Atom, Effect, atoms_of
from tirefit.diagnosis.effects.record import States, xp
from tirefit.diagnosis.effects.state import Covariates, State, null_state
from tirefit.diagnosis.rows.slips import AGES
from tirefit.results import UsageError

ROWS = 30
ATOMS = atoms_of(EFFECTS)
SCALE = np.array([atom.effect.scale for atom in ATOMS])
NUMBER = {(atom.effect.id, atom.variant): k for k, atom in enumerate(ATOMS)}


def covariates(seed: int) -> Covariates:
    """Random values of usual size and sign for every quantity."""
    generator = np.random.default_rng(seed)
    columns = {"work": 3} | dict.fromkeys(("past", "pull", "twist", "burden", "steered"), len(AGES))
    signed = {"side", "turning"}
    positive = {"fz", "v", "usage", "load", "interval", "step", "pace", "sliding", "brisk"}
    positive |= {"cruise", "rise", "peak", "burden"}
    found = {}
    for name in Covariates._fields:
        shape = (ROWS, columns[name]) if name in columns else ROWS
        low, high = (0.3, 2.0) if name in positive else (-0.5, 0.5)
        values = generator.uniform(low, high, shape)
        found[name] = np.sign(values) if name in signed else values
    return Covariates(**found)


def jax_state(present, rows: Covariates) -> State:
    """The state by the formulas on arrays of JAX."""
    state = State(*(jnp.full(ROWS, value) for value in null_state()))
    for number, amplitude in present:
        state = ATOMS[number].change(state, amplitude, Covariates(*map(jnp.asarray, rows)))
    return State(*(jnp.broadcast_to(value, (ROWS,)) for value in state))


def jax_slopes(present, rows: Covariates) -> tuple[State, list[State]]:
    """The same state, and its slopes by the amplitude of each atom that is present."""
    numbers, amplitudes = zip(*present, strict=True)

    def at(amplitudes):
        state = jax_state(zip(numbers, amplitudes, strict=True), rows)
        return state, state

    slopes, state = jax.jacfwd(at, has_aux=True)(jnp.array(amplitudes))
    each = [State(*(np.asarray(field[:, k]) for field in slopes)) for k in range(len(present))]
    return state, each


def close(found, right):
    """Equal within 1e-6 of the largest value, or of 1e-3: 100 times the error of a
    difference, and for a state 1e6 times that of rounding."""
    for field, wanted in enumerate(right):
        mine = found.get(field, np.zeros(ROWS)) if isinstance(found, dict) else found[field]
        atol = 1e-6 * max(float(np.max(np.abs(wanted))), 1e-3)
        np.testing.assert_allclose(mine, wanted, rtol=0, atol=atol, err_msg=State._fields[field])


def amplitude_of(number: int, size: float) -> float:
    """An amplitude within the bounds that is no corner of a formula."""
    effect = ATOMS[number].effect
    low = effect.bounds[ATOMS[number].variant if len(effect.bounds) > 1 else 0][0]
    return (abs(size) if low >= 0 else size) * effect.scale


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(k, id=f"{name}-{v}", marks=[pytest.mark.long] if v > 2 else [])
        for (name, v), k in NUMBER.items()
    ],
)
def test_state_and_slope_of_every_effect_agree_with_jax(number):
    rows = covariates(number)
    states = States(ATOMS, rows, SCALE)
    # Others before and after it, so that it acts on a changed state and is itself changed.
    around = [NUMBER["camber_thrust", 0], NUMBER["load_friction", 0], NUMBER["load_stiffness", 2]]
    around = [(k, 0.3 * ATOMS[k].effect.scale) for k in around if k != number]
    for size in (0.0, 0.37 if number % 2 else -0.37):
        present = [*around[:1], (number, amplitude_of(number, size)), *around[1:]]
        state, slopes = states.slopes(present)
        right_state, right_slopes = jax_slopes(present, rows)
        close(state, right_state)
        np.testing.assert_array_equal(states.state(present), state)
        for found, right in zip(slopes, right_slopes, strict=True):
            close(found, right)


def test_changes_are_slopes_in_addition_or_states_at_a_prior_scale():
    rows, center = covariates(1), np.array([a.effect.center for a in ATOMS]) / SCALE
    names = {"friction_drift": -0.05, "friction_ellipse": 0.2, "slip_offset": 0.02}
    present = [(NUMBER[name, 0], amplitude) for name, amplitude in names.items()]
    states = States(ATOMS, rows, SCALE)
    found = states.changes(present, center)
    assert sorted([*found.slopes, *found.ends]) == list(range(len(ATOMS)))
    for number, atom in enumerate(ATOMS):
        others = [p for p in present if p[0] != number]
        amplitude = dict(present).get(number, 0.0)
        if number in found.slopes:
            assert not atom.effect.misleads
            _, slopes = states.slopes([*others, (number, amplitude)])
            assert found.slopes[number].keys() == slopes[-1].keys()
            for field, right in slopes[-1].items():
                np.testing.assert_array_equal(found.slopes[number][field], right)
        else:
            size = max(atom.effect.center / SCALE[number], 1.0)
            assert atom.effect.misleads and found.sizes[number] == pytest.approx(size)
            right = states.state([*others, (number, amplitude + size * SCALE[number])])
            np.testing.assert_allclose(found.ends[number], right)


def test_only_changed_fields_have_slopes():
    states = States(ATOMS, covariates(2), SCALE)
    friction = State._fields.index("friction")
    present = [(NUMBER["friction_drift", 0], 0.1), (NUMBER["slip_offset", 0], 0.1)]
    _, (drift, offset) = states.slopes(present)
    assert [*drift] == [friction] and [*offset] == [State._fields.index("shift")]


def mine(change) -> States:
    effect = Effect(id="mine", family="friction", change=change, scale=0.1, formula="none")
    return States([Atom(effect)], covariates(3), np.array([0.1]))


def test_an_effect_of_a_user_may_use_jax():
    def change(state, amplitude, constants, rows):
        return state._replace(friction=state.friction * (1 + amplitude * jnp.sin(rows.time)))

    states = mine(change)
    state, (slope,) = states.slopes([(0, 0.2)])
    wave, friction = np.sin(covariates(3).time), State._fields.index("friction")
    assert type(state) is np.ndarray
    np.testing.assert_allclose(state[friction], 1 + 0.2 * wave, rtol=1e-12)
    np.testing.assert_allclose(slope[friction], wave, rtol=0, atol=1e-8)


def _written(state, amplitude, constants, rows):
    time = rows.time
    time += amplitude
    return state._replace(friction=1 + time)


def _written_state(state, amplitude, constants, rows):
    friction = state.friction
    friction *= 1 + amplitude
    return state._replace(friction=friction)


FAULTS = {
    "ValueError: output array is read-only": (_written, _written_state),
    "ValueError: .*broadcast": (lambda s, a, c, rows: s._replace(friction=a * rows.fz[:3]),),
    "TypeError": (lambda s, a, c, rows: None,),
}


@pytest.mark.parametrize(("said", "change"), [(s, c) for s, many in FAULTS.items() for c in many])
def test_a_fault_in_the_effect_of_a_user_is_reported(said, change):
    with pytest.raises(UsageError, match=f"(?s)effect 'mine': {said}.*its change takes"):
        mine(change).state([(0, 0.1)])


def test_a_root_has_no_slope_at_zero_and_a_square_has():
    root = mine(lambda s, a, c, rows: s._replace(shift=s.shift + np.sqrt(abs(a)) * rows.fz))
    square = mine(lambda s, a, c, rows: s._replace(shift=s.shift + (a + a**2) * rows.fz))
    infinite, finite = (one.changes([], np.zeros(1)).slopes[0][0] for one in (root, square))
    assert np.all(np.isinf(infinite))
    np.testing.assert_allclose(finite, covariates(3).fz, rtol=1e-8)


def test_functions_follow_their_arguments():
    assert type(xp.exp(np.ones(2))) is np.ndarray
    assert isinstance(xp.maximum(0.5, jnp.ones(2)), jax.Array)
    traced = jax.jit(lambda x: xp.clip(xp.log1p(x), 0.0, 0.5))(np.arange(3.0))
    np.testing.assert_allclose(traced, np.clip(np.log1p(np.arange(3.0)), 0.0, 0.5))


@pytest.mark.parametrize(
    ("effect", "pattern", "field", "changed"),
    [
        ("slip_offset_run", "run_slip", "shift", lambda a, p: a * p),
        ("force_offset_run", "run_force", "force", lambda a, p: 1e-3 * a * 4000.0 * p),
        ("friction_run", "run_friction", "friction", lambda a, p: np.exp(a * p)),
        ("stiffness_run", "run_stiffness", "stiffness", lambda a, p: np.exp(a * p)),
    ],
)
def test_an_effect_of_runs_changes_one_field_by_its_pattern(effect, pattern, field, changed):
    runs = np.array([-1.2, 0.3, 0.9])
    rows = Covariates(**dict.fromkeys(Covariates._fields, 0.0) | {"load": 4000.0, pattern: runs})
    (record,) = (e for e in EFFECTS if e.id == effect)
    state, null = record.change(null_state(), 0.4, (), rows), null_state()
    np.testing.assert_allclose(getattr(state, field), changed(0.4, runs), rtol=1e-14)
    assert state._replace(**{field: getattr(null, field)}) == null
