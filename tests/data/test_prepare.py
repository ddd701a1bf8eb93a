"""Rig tests are divided correctly: scripts with known commands and settings."""

import numpy as np
import pytest
from rig_script import DEG, Script, combined, cornering, drum, flat, measured

import tirefit
from tirefit.data.read import read_frame
from tirefit.data.rig.prepare import prepare
from tirefit.data.rig.series import zero_phase
from tirefit.data.rig.set_points import Settings, setting_names
from tirefit.results import DataError, UsageError

OF_A_CAR = {"alpha": -0.2, "fz": 3000.0, "gamma": 0.0, "pressure": 2e5, "v": 20.0}


def prepared(columns, **config):
    data = read_frame(columns, curve=False, mask_bad_rows=True)
    return prepare(data, config)


def unlike(script, prepared, channel, tolerance):
    """Differences between a script's sweeps and those that were found."""
    rate, faults = script.rate, []
    asked = [e for e in script.events if e.kind == "swept" and e.channel == channel]
    named = channel.replace("kappa", "sigma_x")
    cut = [p for p in prepared.segments if named in p.channel.split("+")]
    cut = [p for p in cut if p.kind in ("sweep", "warm-up")]
    if len(asked) != len(cut):
        faults.append(f"{len(cut)} sweeps of {len(asked)}")
    for event, part in zip(asked, cut, strict=False):
        apart = max(abs(event.begin - part.begin), abs(event.end - part.end)) / rate
        way = "up" if event.direction > 0 else "down"
        if apart > tolerance * (event.end - event.begin) / rate + 0.1:
            faults.append(f"{apart:.2f} s apart at {event.begin / rate:.2f} s")
        if part.direction != way:
            faults.append(f"{part.direction} at {event.begin / rate:.2f} s")
        for name, level in part.level.items():
            if name not in ("fz", "gamma", "pressure", "v"):
                continue
            center = prepared.settings[name].center[level]
            true = sorted({e.settings[name] for e in script.events})
            if np.argmin(np.abs(np.array(true) - center)) != true.index(event.settings[name]):
                faults.append(f"{name} {center:.4g} is not {event.settings[name]:.4g}")
    return faults + on_the_way(script, prepared)


def on_the_way(script, prepared):
    """Kept rows with a condition at least a quarter of its way from both of its
    settings."""
    truth, faults = script.columns(), []
    for event in script.events:
        if event.kind != "moved" or event.channel in ("alpha", "kappa"):
            continue
        path = truth[event.channel][event.begin : event.end]
        way = (path - path[0]) / (path[-1] - path[0])
        inside = prepared.kept[event.begin : event.end] & (0.25 < way) & (way < 0.75)
        if inside.any():
            where = f"{event.channel} at {event.begin / script.rate:.2f} s"
            faults.append(f"{inside.sum()} rows kept of the way of {where}")
    return faults


def true_levels(script, name):
    held = [e for e in script.events if e.kind != "moved"]
    return sorted({e.settings[name] for e in held})


# --- segments and settings ----------------------------------------------------------


@pytest.mark.parametrize("seed", range(7001, 7005))
def test_a_cornering_test_of_any_design_is_prepared(seed):
    """Of 300 designs with other seeds, three were divided differently."""
    rng = np.random.default_rng(seed)
    shape = str(rng.choice(["line", "sine"]))
    script, rng = cornering(
        seed,
        rate=float(rng.choice([50, 100])),
        shape=shape,
        loads=int(rng.integers(2, 6)),
        cambers=int(rng.integers(1, 4)),
        pressures=int(rng.integers(1, 3)),
    )
    seen, _ = measured(script, rng, noise=rng.uniform(0, 1.5), wander=rng.uniform(0, 1.5))
    result = prepared(seen)
    # A sine begins so slowly that its first tenth is not yet a movement.
    assert unlike(script, result, "alpha", 0.12 if shape == "sine" else 0.04) == []
    for name in ("fz", "gamma", "pressure", "v"):
        center, true = result.settings[name].center, true_levels(script, name)
        assert len(center) == len(true)
        # A separate warm-up is at one of them; the wander is at least 1 %.
        largest = max(map(abs, true)) or 1.0
        np.testing.assert_allclose(center, true, atol=0.03 * largest)
    kinds = {"cold": ("warm-up",), "warm-up": ("warm-up",)}
    for event in script.events:
        cut = {
            part.kind
            for part in result.segments
            if part.begin < event.end - 50 and part.end > event.begin + 50
        }
        if event.note in kinds:
            assert cut <= {*kinds[event.note], "steady", "transition"}
        elif event.note == "spring-rate":
            assert "transition" in cut
        elif event.kind == "swept":
            assert cut == {"sweep"}


@pytest.mark.parametrize("seed", [7011, 7012])
def test_the_returns_of_a_drum_test_are_excluded(seed):
    script, rng = drum(seed)
    seen, _ = measured(script, rng, mu=1.0)
    result = prepared(seen)
    assert unlike(script, result, "kappa", 0.05) == []
    speeds, loads = (result.settings[name].center for name in ("v", "fz"))
    assert len(speeds) == 2 and len(loads) == 3
    assert {part.direction for part in result.segments if part.kind == "sweep"} == {"up"}


def test_a_constant_slip_angle_is_part_of_the_bin():
    script, rng = combined(7021)
    seen, _ = measured(script, rng, mu=1.0)
    result = prepared(seen)
    assert unlike(script, result, "kappa", 0.05) == []
    np.testing.assert_allclose(
        result.settings["alpha"].center, np.array([-6, -3, 0]) * DEG, atol=0.1 * DEG
    )
    bins = {part.bin for part in result.segments if part.kind == "sweep"}
    assert bins == {f"{n} N {a} deg" for n in (2000, 4000) for a in (0, -3, -6)}


def test_points_without_time_are_refused_with_a_remedy():
    columns, _ = flat(7041)
    with pytest.raises(DataError, match="(?s)no time that rises.*--rate.*without `prepare`"):
        prepared(columns)
    with pytest.raises(DataError, match="(?s)4 rows per second.*fewer than 4.*longer `shortest`"):
        prepared(columns, rate=4.0)


def steady_points(rng):
    """Angles stepped through, each held for a while, at two loads."""
    script = Script(100, alpha=0.0, fz=1000.0, gamma=0.0, pressure=2e5, v=20.0)
    for load in (1000.0, 3000.0):
        script.move("fz", load, 1.0)
        script.hold(2)
        for degrees in (-6, -3, 0, 3, 6):
            script.move("alpha", degrees * DEG, 0.7)
            script.hold(rng.uniform(3, 6))
    return script


def test_steady_states_between_steps_are_found():
    rng = np.random.default_rng(7)
    script = steady_points(rng)
    seen, clean = measured(script, rng)
    result = prepared(seen, warm_up=0.0)
    states = [part for part in result.segments if part.kind == "steady"]
    assert not [part for part in result.segments if part.kind == "sweep"]
    assert on_the_way(script, result) == []
    held = [e for e in script.events if e.kind == "held"]
    for event in held:
        middle = (event.begin + event.end) // 2
        (state,) = [s for s in states if s.begin <= middle < s.end]
        # The ends of the ways are slow as well.
        assert state.begin >= event.begin - 20 and state.end <= event.end + 20
        assert state.first >= event.begin and state.last <= event.end
        assert state.last - state.first > 0.6 * (event.end - event.begin)
        alpha = seen["alpha"][state.first : state.last]
        assert np.median(alpha) == pytest.approx(event.settings["alpha"], abs=5e-4)


def test_declared_settings_are_used():
    script, rng = cornering(7051, loads=2, cambers=1, pressures=1)
    seen, _ = measured(script, rng)
    sweeps = [e for e in script.events if e.kind == "swept" and e.channel == "alpha"]
    result = prepared(seen, warm_up=0.0, keep=["sweep"], bandwidth=6.0)
    assert result.filter.bandwidth == 6.0
    assert sum(part.kind == "sweep" for part in result.segments) == len(sweeps)
    kinds = {p.kind for p in result.segments if result.kept[p.begin : p.end].any()}
    assert kinds == {"sweep"}
    without = {name: values for name, values in seen.items() if name != "time"}
    timed = prepared(without, rate=100.0, warm_up=0.0, filter=False)
    assert sum(part.kind == "sweep" for part in timed.segments) == len(sweeps)
    assert timed.filter is None
    np.testing.assert_array_equal(timed.columns["fy"], seen["fy"])
    early = prepared(seen, warm_up=140.0)
    assert all(p.kind != "sweep" for p in early.segments if p.end < 140 * script.rate)
    with pytest.raises(UsageError, match="keep"):
        prepared(seen, keep=["sweeps"])


def test_prepared_data_can_be_fitted():
    script, rng = cornering(7055, rate=50, loads=2, cambers=1, pressures=1)
    seen, _ = measured(script, rng)
    result = prepared(seen)
    data, by_bin, by_segment = (result.to_data(by) for by in ("run", "bin", "segment"))
    assert "2 bins" in repr(result) and data.n == result.kept.sum()
    np.testing.assert_array_equal(data.usable("fy"), result.columns["fy"][result.kept])
    assert len(by_bin.runs) == 2 and data.runs == ("data",)
    for code, name in enumerate(by_bin.runs):
        rows = by_bin.used & (by_bin.run == code)
        load = np.median(by_bin["fz"][rows])
        assert float(name.split()[0]) == pytest.approx(load, rel=0.03)
    swept = [p for p in result.segments if p.kind in ("sweep", "steady")]
    kept = [p for p in swept if result.kept[p.begin : p.end].any()]
    assert len(by_segment.runs) == len(kept)
    with pytest.raises(UsageError, match="by = 'load'"):
        result.to_data("load")


def warmed_in(gamma=4 * DEG, keep_on=False):
    """Two cambers swept while the tire warms up, one of them again afterwards."""
    script = Script(50, alpha=0.0, fz=3000.0, gamma=0.0, pressure=2e5, v=0.0)
    script.hold(1)
    script.move("v", 20.0, 2)
    for camber in (gamma, 0.0):
        script.move("gamma", camber, 1)
        script.hold(1)
        for _ in range(2):
            script.sweep("alpha", 0.15, 2, "early")
            script.sweep("alpha", -0.15, 4, "early")
            script.sweep("alpha", 0.0, 2)
    script.hold(80)
    for _ in range(12):
        script.sweep("alpha", 0.15, 2)
        script.sweep("alpha", -0.15, 4)
        script.sweep("alpha", 0.0, 2)
        script.hold(1)
    seen, _ = measured(script, np.random.default_rng(3))
    return script, seen


def swept_rows(result, gamma):
    """Kept rows of sweeps near a camber, and its segments."""
    level = int(np.argmin(np.abs(result.settings["gamma"].center - gamma)))
    parts = [p for p in result.segments if p.direction and p.level["gamma"] == level]
    return sum(int(result.kept[p.begin : p.end].sum()) for p in parts), parts


def test_a_condition_that_is_lost_in_the_warm_up_is_reported():
    _, seen = warmed_in()
    result = prepared(seen)
    assert swept_rows(result, 4 * DEG)[0] == 0
    (note,) = [note for note in result.notes if "no kept rows" in note]
    assert "1 of 2 conditions have no kept rows: 4 deg (alpha) (if" in note and "--warm-up" in note
    rows, parts = swept_rows(result, 0.0)
    assert rows and any(p.kind == "warm-up" for p in parts)
    assert swept_rows(prepared(seen, warm_up=2.0), 4 * DEG)[0]


def test_bins_name_every_setting_that_differs():
    """Camber and slip angle of equal degrees, and a pressure that differs only in the
    warm-up: no two conditions have the same label."""
    script = Script(50, alpha=0.0, kappa=0.0, fz=3000.0, gamma=0.0, pressure=1.8e5, v=20.0)
    for pressure, camber, angle in (
        (1.8e5, 0.0, 0.0),
        (2.2e5, 0.0, 0.0),
        (2.2e5, 0.0, 3 * DEG),
        (2.2e5, 3 * DEG, 0.0),
        (2.2e5, 3 * DEG, 3 * DEG),
    ):
        for name, value in zip(
            ("pressure", "gamma", "alpha"), (pressure, camber, angle), strict=True
        ):
            script.move(name, value, 1.0)
        script.hold(2)
        for _ in range(3):
            script.sweep("kappa", 0.15, 2)
            script.sweep("kappa", -0.05, 2)
        script.sweep("kappa", 0.0, 1)
        script.hold(2)
    seen, _ = measured(script, np.random.default_rng(3), mu=1.0)
    result = prepared(seen, warm_up=16.0)
    labels = {}
    for part in result.segments:
        if part.is_held:
            level = {k: v for k, v in part.level.items() if v >= 0}
            labels.setdefault(part.bin, set()).add(tuple(sorted(level.items())))
    assert all(len(levels) == 1 for levels in labels.values()), labels
    assert "3 deg camber 220 kPa 3 deg slip angle" in labels
    assert any("180 kPa" in label for label in labels)


def test_gaps_and_bad_rows_split_only_their_sweeps():
    script, rng = cornering(7061, loads=2, cambers=1, pressures=1)
    seen, _ = measured(script, rng)
    sweeps = [e for e in script.events if e.kind == "swept" and not e.note]
    one, other = sweeps[1], sweeps[3]
    spoilt = {name: np.array(values) for name, values in seen.items()}
    bad = (one.begin + one.end) // 2
    spoilt["fy"][bad : bad + 3] = np.nan
    result = prepared(spoilt)
    (part,) = [p for p in result.segments if p.begin <= bad < p.end]
    assert part.kind == "sweep" and not result.kept[bad : bad + 3].any()
    assert result.kept[bad - 5] and result.kept[bad + 5]
    cut = slice(other.begin + 40, other.begin + 90)
    rest = {name: np.delete(values, cut) for name, values in seen.items()}
    broken = prepared(rest)
    ends = {p.begin for p in broken.segments}
    assert cut.start in ends
    assert len(broken.series.pieces) == 2


def test_an_absurd_load_is_cut_and_hides_no_setting():
    script, rng = cornering(7055, rate=50, loads=2, cambers=1, pressures=1)
    seen, _ = measured(script, rng)
    right = prepared(seen)
    rows = slice(len(seen["fz"]) // 2, len(seen["fz"]) // 2 + 40)
    seen["fz"] = np.array(seen["fz"])
    seen["fz"][rows] = 5e6
    result = prepared(seen)
    assert result.names["fz"] == right.names["fz"] and len(right.names["fz"]) == 2
    assert not result.kept[rows].any() and result.kept.sum() > 0.9 * right.kept.sum()
    assert any("40 rows have a load far from all others" in note for note in result.notes)


def test_a_slip_angle_in_a_wrong_unit_is_no_sweep():
    script, rng = cornering(7055, rate=50, loads=2, cambers=1, pressures=1)
    seen, _ = measured(script, rng)
    told = [n for n in prepared(seen).notes if n.startswith("no sweep")]
    seen["alpha"] = seen["alpha"] * DEG  # radians that are read as degrees
    (note,) = [n for n in prepared(seen).notes if n.startswith("no sweep")]
    assert told == [] and "--unit alpha=rad" in note


def test_data_without_settings_or_sweeps_are_refused():
    n = 400
    columns = {"time": np.arange(n) / 100, "fz": np.full(n, 1e3), "fy": np.ones(n)}
    with pytest.raises(DataError, match="no slip"):
        prepared(columns)
    columns["alpha"] = np.zeros(n)
    with pytest.raises(DataError, match="no rows remain"):
        prepared(columns, keep=["sweep"])


@pytest.mark.parametrize(
    ("name", "centers", "names"),
    [
        ("fz", [222.1, 445.3, 1111.8], ["222 N", "445 N", "1112 N"]),
        ("gamma", [-0.03492, 1e-7, 0.03488], ["-2 deg", "0 deg", "2 deg"]),
        ("pressure", [82_640.0, 96_610.0], ["82.6 kPa", "96.6 kPa"]),
        ("v", [0.51, 0.53], ["0.51 m/s", "0.53 m/s"]),
        ("fz", [3998.7], ["4000 N"]),
    ],
)
def test_settings_have_the_fewest_digits_that_distinguish_them(name, centers, names):
    none = np.zeros(len(centers))
    assert setting_names(Settings(name, np.array(centers), none, none)) == names


# --- the filter ----------------------------------------------------------------------


@pytest.mark.parametrize(("bandwidth", "rate"), [(5.0, 100.0), (12.0, 50.0)])
def test_the_filter_has_the_stated_gain_and_no_delay(bandwidth, rate):
    """Two passes of order 2 with -3 dB together at the bandwidth, in prewarped frequency."""
    chosen = zero_phase(bandwidth, rate)

    def gain(frequency):
        ratio = np.tan(np.pi * frequency / rate) / np.tan(np.pi * bandwidth / rate)
        return 1 / (1 + (np.sqrt(2) - 1) * ratio**4)

    time = np.arange(round(60 * rate)) / rate
    middle = slice(round(20 * rate), round(40 * rate))
    for frequency in bandwidth * np.array([0.1, 0.5, 1.0, 1.5]):
        wave = np.exp(2j * np.pi * frequency * time)
        answer = chosen(wave.real) + 1j * chosen(wave.imag)
        ratio = (answer / wave)[middle]
        np.testing.assert_allclose(ratio.real, gain(frequency), atol=1e-6)
        np.testing.assert_allclose(ratio.imag, 0, atol=1e-6)


@pytest.mark.parametrize("bandwidth", [2.0, 5.0])
def test_a_step_has_an_effect_of_a_hundredth_up_to_the_reach(bandwidth):
    chosen = zero_phase(bandwidth, 400.0)
    time = (np.arange(2000) - 999.5) / 400
    off = np.abs(chosen((time > 0).astype(float)) - (time > 0))
    assert off[np.abs(time) > chosen.reach].max() < 0.01
    assert off[np.abs(time) > 0.9 * chosen.reach].max() > 0.01


def test_prepared_channels_have_the_same_gain_and_no_delay():
    """A tone on every channel is the same in all, in phase."""
    script, rng = cornering(7071, loads=2, cambers=1, pressures=1)
    seen, _ = measured(script, rng, noise=0.2)
    tone = np.sin(2 * np.pi * 8.0 * seen["time"])
    size = {"alpha": 1e-3, "fy": 30.0, "gamma": 1e-3, "temperature": 1.0}
    toned = {k: v + size.get(k, 0.0) * tone for k, v in seen.items()}
    one, other = (prepared(c, bandwidth=8.0) for c in (toned, seen))
    middle = slice(500, -500)
    for name, amplitude in size.items():
        rest = (one.columns[name] - other.columns[name])[middle] / amplitude
        share = 2 * np.mean(rest * tone[middle])
        assert share == pytest.approx(np.sqrt(0.5), rel=1e-3)


@pytest.mark.parametrize(("shape", "most"), [("line", 2.2e-3), ("sine", 5.5e-3)])
def test_the_chosen_bandwidth_keeps_the_slip_curve(shape, most):
    script, rng = Script(200, **OF_A_CAR), np.random.default_rng(1)
    for to in (0.2, -0.2, 0.2, -0.2, 0.2, -0.2):
        script.sweep("alpha", to, 3.0, shape=shape)
    seen, _ = measured(script, rng, noise=0.0, wander=0.0)

    def brush(alpha):
        share = np.minimum(np.abs(np.tan(alpha)) / 0.04, 1)
        return np.sign(alpha) * (3 * share - 3 * share**2 + share**3)

    seen["fy"] = 3000 * brush(seen["alpha"])
    result = prepared(seen, warm_up=0.0, settle=0.0)
    rows = np.flatnonzero(result.kept)[25:-25]
    assert len(rows) > 250 and result.filter is not None
    kept = {name: result.columns[name][rows] for name in ("alpha", "fy")}
    miss = kept["fy"] / 3000 - brush(kept["alpha"])
    assert 0.1 * most < np.max(np.abs(miss)) < most


def true_brush(seed, steps=0.0, alpha_noise=0.0):
    """Sweeps of 1 s at 200 Hz, force noise of 40 N; ``steps`` [rad]: movement of each row."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 16.0, 0.005)
    alpha = 0.15 * (4 * np.abs(time / 2 - np.floor(time / 2 + 0.5)) - 1)
    alpha += steps * rng.normal(size=len(time))
    share = np.minimum(np.abs(np.tan(alpha)) * 8e4 / (3 * 3800.0), 1)
    force = 3800.0 * np.sign(alpha) * (3 * share - 3 * share**2 + share**3)
    columns = {"time": time, "alpha": alpha, "fz": np.full_like(time, 4000.0)}
    columns["alpha"] = alpha + alpha_noise * rng.normal(size=len(time))
    return columns | {"fy": force + 40.0 * rng.normal(size=len(time))}


def test_kept_rows_are_independent():
    """White noise after the filter, at the spacing of the kept rows; 4 standard errors."""
    rng = np.random.default_rng(7)
    for bandwidth, rate in ((25.0, 200.0), (25.0, 1000.0), (8.0, 100.0), (25.0, 100.0)):
        chosen = zero_phase(bandwidth, rate)
        kept = chosen(rng.normal(size=200_000))[:: chosen.step]
        at = 2 * bandwidth * chosen.step / rate  # spacing over half a cycle
        assert 1.0 <= at < 1 + 2 * bandwidth / rate
        correlation = np.mean(kept[1:] * kept[:-1]) / np.mean(kept**2)
        assert -0.13 < correlation < 0.01 + 4 / np.sqrt(len(kept))
    result = prepared(true_brush(1))
    data = result.to_data()
    steps = np.diff(data["time"][data.used])
    assert np.min(steps) > 0.019 and np.median(steps) == pytest.approx(0.02)


@pytest.mark.parametrize("seed", [101, 102, 103])
def test_a_fit_and_a_diagnosis_of_a_prepared_brush_find_no_fault(seed):
    """Seeds that no number of the filter was chosen on."""
    data = prepared(true_brush(seed)).to_data()
    fit = tirefit.fit(data, "brush")
    assert fit.status == "ok"
    for name, true in (("cpa2", 4e4), ("mu", 0.95)):
        found = fit.parameters[name]
        assert abs(found.value - true) < 4 * found.std
    assert tirefit.diagnose(data, "brush").verdict.status == "none"


def test_a_slip_that_moves_beyond_the_filter_is_not_filtered():
    """The force of a filtered slip is not the filtered force: by both, a brush loses 7 % of its
    stiffness (40 standard errors). Noise of the slip alone is filtered."""
    moved, noisy = true_brush(103, steps=0.02), true_brush(103, alpha_noise=0.02)
    result = prepared(moved)
    assert result.filter is None and any("follows the slip" in note for note in result.notes)
    assert prepared(noisy).filter is not None
    stiffness = tirefit.fit(result.to_data(), "brush").parameters["cpa2"]
    assert abs(stiffness.value - 4e4) < 4 * stiffness.std
    declared = prepared(moved, bandwidth=25.0)
    assert declared.filter is not None and "give filter = false" in "".join(declared.notes)
    assert abs(tirefit.fit(declared.to_data(), "brush").parameters["cpa2"].value - 4e4) > 2000.0


def test_the_filter_keeps_a_parabola_at_uneven_times():
    chosen = zero_phase(4.0, 100.0)
    time = np.arange(1000) / 100
    curve = 3 - 2 * time + 0.5 * time**2
    np.testing.assert_allclose(chosen(curve)[200:-200], curve[200:-200], atol=1e-6)
    rng = np.random.default_rng(3)
    uneven = np.sort(time + rng.uniform(-0.004, 0.004, 1000))
    slow, fast = np.sin(2 * np.pi * 0.5 * uneven), np.sin(2 * np.pi * 15 * uneven)
    out = chosen(slow + fast, uneven)
    # Straight lines between samples 0.4 steps off cost the fast wave 4 %.
    np.testing.assert_allclose(out[100:-100], slow[100:-100], atol=0.05)
    assert zero_phase(50.0, 100.0) is None


# --- anything ------------------------------------------------------------------------


def anything(rng):
    """Columns without meaning: few or many rows, constant, jumping, missing, huge."""
    n = int(rng.choice([1, 2, 5, 20, 60, 300, 1000]))
    wild = rng.normal(size=n)
    columns = {
        "alpha": np.clip(rng.choice([0, 0.01, 0.1]) * wild.cumsum() / n**0.5, -1.5, 1.5),
        "fz": 1000 + rng.choice([0, 1, 300]) * np.abs(rng.normal(size=n)),
        "fy": rng.normal(size=n) * rng.choice([0, 1, 500]),
        "time": np.arange(n) * rng.choice([0, 1e-3, 0.01, 100.0]),
        "gamma": rng.choice([0, 0.05], size=n),
        "v": np.abs(rng.normal(size=n)) * rng.choice([0, 10]),
        "temperature": 20 + rng.normal(size=n).cumsum(),
    }
    kept = {k: v for k, v in columns.items() if k in ("alpha", "fz") or rng.random() < 0.6}
    spoilt = str(rng.choice(list(kept)))
    rows = rng.integers(0, n, size=n // 10)
    kept[spoilt] = np.array(kept[spoilt], float)
    kept[spoilt][rows] = rng.choice([np.nan, np.inf, 1e9, -1e3])
    return kept


def test_any_recording_is_prepared_or_refused():
    """1,500 other seeds gave no other outcome."""
    rng, done = np.random.default_rng(7081), 0
    for _ in range(90):
        try:
            result = prepared(anything(rng), rate=50.0, keep=["sweep", "steady", "warm-up"])
        except DataError:
            continue
        done += 1
        edges = [part.begin for part in result.segments] + [len(result.data)]
        assert [0, *(part.end for part in result.segments)] == edges
        assert not np.any(result.kept & ~result.data.used)
        for values in result.columns.values():
            assert np.isfinite(values[result.kept]).all()
    assert done > 15
