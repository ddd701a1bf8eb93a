"""Segment, bin and filter the recording of a rig test: :func:`prepare`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from tirefit.data.accept import DataLike, as_data
from tirefit.data.far import without_far
from tirefit.data.rig.segments import Segment, segments_of, trimmed, with_warmth
from tirefit.data.rig.series import Series, ZeroPhase, bridged, runs_of, series_of, zero_phase
from tirefit.data.rig.set_points import Settings, Window, bin_name, setting_names, settings_of
from tirefit.data.rig.settings import PrepareConfig
from tirefit.data.rig.slips import HELD, LEAST, MOVED, SWEPT, Leg, legs, number_of
from tirefit.data.table import TireData
from tirefit.data.units import slip_from_sigma, slip_to_sigma
from tirefit.display import Record
from tirefit.results import DataError, UsageError
from tirefit.settings import parse_settings

CONDITIONS = ("fz", "gamma", "pressure", "v")
FORCE_OF = {"alpha": "fy", "sigma_x": "fx"}

_LOOK = 5.0  # bandwidth [Hz] of the channels in which segments are searched; rigs are slower
_SHARE_OF_RATE = 0.2
_WINDOW = 1.0  # length [s] of the windows of a hold in which settings are searched
_LEAST_ROWS = 4
"""Smallest number of rows in the shortest hold: with fewer, rows are points and no series."""
_CYCLES = 40.0
"""Bandwidth times the duration of a fast sweep. The filter then changes a brush that slides above a
fifth of the largest slip by 0.2 % of its peak in sweeps of constant speed, by 0.5 % in sines."""
_FOLLOWED = 0.02
"""Movement of the force with the slip beyond the bandwidth, over its peak, from which nothing is
filtered: the force of a filtered slip is not the filtered force. A brush with steps of slip at
each row lost 0.4, 1.8 and 7 % of its stiffness at 0.026, 0.052 and 0.105."""
_STANDING = 0.02  # share of the highest speed below which the wheel does not roll
_FASTEST = 0.1  # quantile of the durations of sweeps that counts as fast
_LOWEST, _HIGHEST = 2.0, 25.0  # range of the bandwidth [Hz] that is chosen


@dataclass(frozen=True, repr=False)
class Prepared(Record):
    """The result of :func:`prepare` for a file; ``read`` are the arguments of
    ``tirefit.read``, for the record."""

    text_by: ClassVar[str] = "tirefit.data.rig.store:summary"
    plot_by: ClassVar[str] = "tirefit.report.prepared:prepared_figure"
    save_by: ClassVar[str] = "tirefit.data.rig.store:save_prepared"

    data: TireData
    config: PrepareConfig
    series: Series  # the clock
    settings: dict[str, Settings]  # settings of each condition
    names: dict[str, list[str]]  # names of its settings, as in bins
    segments: tuple[Segment, ...]  # of all rows, in order
    columns: dict[str, np.ndarray]  # (n,) canonical channels after the filter, all rows
    kept: np.ndarray  # (n,) bool, rows to be written
    filter: ZeroPhase | None
    notes: tuple[str, ...] = field(default=())  # steps and assumptions
    read: Mapping[str, Any] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the file as it was read."""
        return self.data.source.warnings

    def __repr__(self) -> str:
        kept, bins = int(self.kept.sum()), {p.bin for p in self.segments if p.bin}
        what = f"{len(self.segments)} segments, {len(bins)} bins"
        return f"Prepared({self.data.name!r}, {kept} of {len(self.kept)} rows: {what})"

    def to_data(self, by: str = "run") -> TireData:
        """The data to fit: the kept rows, filtered, in canonical columns.

        Args:
            by: which rows become a run: "run" (of the file), "segment" or "bin".

        Raises:
            UsageError: ``by`` is something else.
        """
        columns = {"time": self.series.time} | self.columns
        data = replace(self.data, columns=columns, used=self.kept)
        if by == "run":
            return data
        if by not in ("segment", "bin"):
            raise UsageError(f"by = {by!r}", "run, segment or bin")
        run, codes = np.zeros(len(data), int), dict[str, int]()
        for number, part in enumerate(self.segments):
            if self.kept[part.begin : part.end].any():
                name = str(number + 1) if by == "segment" else part.bin or "none"
                run[part.begin : part.end] = codes.setdefault(name, len(codes))
        return replace(data, run=run, runs=tuple(codes))

    def to_dict(self) -> dict[str, Any]:
        """Content of ``NAME.prepare.json``, without the digests of the tables."""
        from tirefit.data.rig.store import record_of  # imports this module

        return record_of(self, {})

    def rows_by_kind(self, kept: bool = False) -> dict[str, int]:
        """Rows of each kind of segment.

        Args:
            kept: whether only rows that are kept count.

        Returns:
            Kind -> number of rows, in order of appearance.
        """
        rows: dict[str, int] = {}
        for part in self.segments:
            count = int(self.kept[part.begin : part.end].sum()) if kept else part.end - part.begin
            rows[part.kind] = rows.get(part.kind, 0) + count
        return rows


def prepare(data: DataLike, config: PrepareConfig | dict[str, Any] | None = None) -> Prepared:
    """Find the segments of a rig test, and prepare its data for a fit.

    Args:
        data: a result of ``tirefit.read`` (best with ``curve=False`` and
            ``mask_bad_rows=True``), a path, a frame or a mapping of arrays.
        config: see :class:`~tirefit.data.rig.settings.PrepareConfig`.

    Returns:
        Segments, settings and filtered channels; its ``to_data()`` can be fitted.

    Raises:
        DataError: no slip or no time was recorded, or no rows remain.
        UsageError: unknown or impossible settings.

    Example:
        >>> time = np.arange(0.0, 20.0, 0.02)
        >>> alpha = 0.15 * np.sin(0.6 * time)
        >>> fy, fz = 4e3 * np.tanh(12 * alpha), np.full_like(time, 4e3)
        >>> made = prepare({"time": time, "alpha": alpha, "fy": fy, "fz": fz})
        >>> made.rows_by_kind()
        {'sweep': 970, 'steady': 30}
    """
    data = as_data(data, curve=False, mask_bad_rows=True)
    config = config if config is not None else PrepareConfig()
    if isinstance(config, dict):
        config = parse_settings(PrepareConfig, config, "config")
    slips = [name for name in ("alpha", "sigma_x") if name in data]
    if not slips:
        reason = "no slip and no slip angle, by which the test would be segmented"
        remedy = "name one, as in --column alpha=HEADER; see `tirefit inspect`"
        raise DataError(reason, remedy, data.file)
    absurd, data = data.used, without_far(data, ("fz",))
    absurd = absurd & ~data.used
    series = series_of(data, config.rate)
    raw = _channels(data, series, absurd)
    if series.rate * config.shortest < _LEAST_ROWS:
        reason = f"{series.rate:.3g} rows per second: the shortest hold of {config.shortest:g} s"
        reason += f" has fewer than {_LEAST_ROWS}, so that sweeps cannot be told from holds"
        remedy = "fit such points without `prepare`, or give a longer `shortest` in [prepare]"
        raise DataError(reason, remedy, data.file)
    settings, parts, notes = _looked_at(data, config, series, raw, slips)
    chosen, how = _chosen_filter(config, series, parts, raw)
    reach = chosen.reach if chosen else 0.0
    margin = round((config.settle + reach) * series.rate)
    ends = {piece.start for piece in series.pieces} | {len(data)}
    parts = trimmed(parts, margin, ends)
    columns = {name: chosen.smoothed(raw[name], series) if chosen else raw[name] for name in raw}
    if "sigma_x" in columns:
        columns["sigma_x"] = slip_to_sigma(columns["sigma_x"], "slip_ratio")
    names = {name: setting_names(s) for name, s in settings.items() if s.is_held}
    held = [part for part in parts if part.is_held]
    varied = {name for name in names if len({part.level.get(name, -1) for part in held} - {-1}) > 1}
    parts = [replace(p, bin=bin_name(p.level, names, varied)) if p.is_held else p for p in parts]
    kept = np.zeros(len(data), bool)
    for part in parts:
        if part.kind in config.keep:
            kept[part.first : part.last] = True
    kept &= data.used
    if chosen is not None:
        kept &= chosen.independent(series)
    if not kept.any():
        reason = f"no rows remain of {', '.join(dict.fromkeys(p.kind for p in parts))}"
        remedy = "look at the segments in the figure, or keep other kinds"
        raise DataError(reason, remedy, data.file)
    notes.append(how)
    if not any(part.direction for part in parts):
        ranges = [f"{name} {np.min(raw[name]):.3g} to {np.max(raw[name]):.3g}" for name in slips]
        notes.append(
            f"no sweep was found ({', '.join(ranges)}; rad and ratio): if the rig swept a slip,"
            " check its column and unit (--column alpha=HEADER, --unit alpha=rad)"
        )
    notes += _lost_conditions(parts, kept)
    if absurd.any():
        load = float(np.max(np.abs(data.columns["fz"][absurd])))
        notes.append(f"{absurd.sum()} rows have a load far from all others (up to {load:.3g} N)")
    unusable = len(data) - data.n
    if unusable:
        notes.append(f"{unusable} unusable rows are cut: see `masked` in the JSON")
    return Prepared(
        data, config, series, settings, names, tuple(parts), columns, kept, chosen, tuple(notes)
    )


def _lost_conditions(parts: list[Segment], kept: np.ndarray) -> list[str]:
    """A note on conditions without kept rows; one that was swept needs rows of sweeps."""
    swept = {part.bin for part in parts if part.is_held and part.direction}
    rows: dict[str, int] = {}
    for part in parts:
        if part.is_held and (part.direction or part.bin not in swept):
            name = f"{part.bin} ({part.channel})" if part.channel else part.bin
            rows[name] = rows.get(name, 0) + int(kept[part.begin : part.end].sum())
    lost = [name for name, count in rows.items() if not count]
    words = f"{len(lost)} of {len(rows)} conditions have no kept rows: {'; '.join(lost)}"
    return [f"{words} (if their warm-up was cut, shorten it with --warm-up)"] if lost else []


def _channels(data: TireData, series: Series, absurd: np.ndarray) -> dict[str, np.ndarray]:
    """All channels (n,) without gaps and ``absurd`` rows; the slip as a ratio, which is bounded."""
    out = {}
    for name, values in data.columns.items():
        if name == "time" or name.endswith("_std") or not np.isfinite(values).any():
            continue
        filled = np.where(absurd, np.nan, values)
        if name == "sigma_x":
            filled = slip_from_sigma(filled, "slip_ratio")
        for piece in series.pieces:
            filled[piece] = bridged(filled[piece], series.time[piece])
        out[name] = bridged(filled, np.arange(len(filled), dtype=float))
    return out


def _looked_at(
    data: TireData,
    config: PrepareConfig,
    series: Series,
    raw: Mapping[str, np.ndarray],
    slips: Sequence[str],
) -> tuple[dict[str, Settings], list[Segment], list[str]]:
    """Settings, segments and notes of a series."""
    rate = series.rate
    shortest = max(round(config.shortest * rate), 2)
    look = zero_phase(min(_LOOK, _SHARE_OF_RATE * rate), rate)
    assert look is not None  # the bandwidth is below the limit of the rate
    smooth = {name: look.smoothed(raw[name], series) for name in raw}
    its_legs = {}
    for name in slips:
        rest = raw[name] - smooth[name]
        noise = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
        noise *= np.sqrt(2 * look.bandwidth / rate)
        its_legs[name] = legs(smooth[name], series.pieces, noise, LEAST[name], shortest)
    windows = _windows(its_legs, round(_WINDOW * rate))
    settings = {
        name: settings_of(name, smooth[name], windows, series.pieces, shortest)
        for name in CONDITIONS
        if name in smooth
    }
    messages = [
        f"{s.name} is never held: no bins of it" for s in settings.values() if not s.is_held
    ]
    held = {name: s for name, s in settings.items() if s.is_held}
    held_slips = _held_slips(its_legs, smooth, series, shortest)
    parts = segments_of(series, ~data.used, held, its_legs, smooth, shortest)
    speeds = np.abs(held["v"].center) if "v" in held else np.zeros(0)
    for k, part in enumerate(parts):
        if part.is_held:  # with the setting of the slip that it does not sweep
            middle, swept = (part.begin + part.end) // 2, part.channel.split("+")
            level = {n: int(s.code[middle]) for n, s in held_slips.items() if n not in swept}
            stands = len(speeds) and speeds[part.level["v"]] <= _STANDING * np.max(speeds)
            kind = "standing" if stands else part.kind
            parts[k] = replace(part, kind=kind, level={**part.level, **level})
    parts, how = with_warmth(parts, series.time, smooth.get("temperature"), config.warm_up)
    return held | held_slips, parts, [*messages, how]


def _windows(its_legs: Mapping[str, list[Leg]], second: int) -> list[Window]:
    """Windows in which settings are searched: whole sweeps, and seconds of holds."""
    key = np.stack([number_of(each) for each in its_legs.values()], axis=1)
    windows = []
    for begin, end in runs_of(key):
        hows = {each[k].how for each, k in zip(its_legs.values(), key[begin], strict=True)}
        if MOVED in hows:
            continue
        if SWEPT in hows:
            windows.append(Window(begin, end, True))
            continue
        # Windows overlap by half, so that a hold of 1.5 s contains a whole one.
        last = max(end - second, begin)
        starts = {*range(begin, last, max(second // 2, 1)), last}
        windows += [Window(a, min(a + second, end), False) for a in sorted(starts)]
    return [window for window in windows if window.end - window.begin >= 3]


def _held_slips(
    its_legs: Mapping[str, Sequence[Leg]],
    smooth: Mapping[str, np.ndarray],
    series: Series,
    shortest: int,
) -> dict[str, Any]:
    """Settings of a slip in segments in which it is held and the other one swept."""
    out = {}
    for name, all_legs in its_legs.items():
        others = [leg for other in its_legs if other != name for leg in its_legs[other]]
        held = [leg for leg in all_legs if leg.how == HELD and leg.rows >= 3]
        if held and any(leg.how == SWEPT for leg in others):
            windows = [Window(leg.begin, leg.end, False) for leg in held]
            out[name] = settings_of(name, smooth[name], windows, series.pieces, shortest)
    return {name: settings for name, settings in out.items() if settings.is_held}


def _chosen_filter(
    config: PrepareConfig, series: Series, parts: Sequence[Segment], raw: Mapping[str, np.ndarray]
) -> tuple[ZeroPhase | None, str]:
    """The filter of all channels, and a note on it."""
    rate = series.rate
    if not config.filter:
        return None, "not filtered, as declared"
    how, bandwidth = "as declared", config.bandwidth
    if bandwidth is None:
        times = [(p.end - p.begin) / rate for p in parts if p.kind == "sweep"]
        fast = float(np.quantile(times, _FASTEST)) if times else 0.0
        bandwidth = _CYCLES / fast if times else _LOOK
        bandwidth = float(np.clip(bandwidth, _LOWEST, _HIGHEST))
        how = f"{_CYCLES:.0f} cycles of it in the fast sweeps of {fast:.2g} s"
        how = how if times else "there is no sweep from which to choose it"
        bandwidth = float(f"{bandwidth:.2g}")
    chosen = zero_phase(bandwidth, rate)
    if chosen is None:
        message = f"not filtered: {rate:.4g} rows per second are too few for"
        return None, f"{message} {bandwidth:g} Hz"
    beyond = _followed(chosen, series, parts, raw)
    if beyond > _FOLLOWED:
        warning = f"beyond {bandwidth:g} Hz the force follows the slip by {beyond:.0%} of its peak"
        if config.bandwidth is None:
            return None, f"not filtered: {warning}, and the filter would change the tire's curve"
        how += f"; {warning}, so the filter changes the tire's curve: give filter = false"
    message = (
        "all channels by one zero-phase filter (Butterworth, forwards and backwards) of"
        f" {bandwidth:g} Hz (-3 dB; {how})"
    )
    if chosen.step > 1:
        message += f"; each row of {chosen.step} is kept, as those between are not independent"
    return chosen, message


def _followed(
    chosen: ZeroPhase, series: Series, parts: Sequence[Segment], raw: Mapping[str, np.ndarray]
) -> float:
    """The largest movement of a force with its slip beyond the bandwidth, see
    :meth:`~tirefit.data.rig.series.ZeroPhase.force_beyond`."""
    moves = [0.0]
    for slip, force in FORCE_OF.items():
        swept = [p for p in parts if p.direction and slip in p.channel.split("+")]
        if swept and force in raw:
            rows = np.concatenate([np.arange(p.begin, p.end) for p in swept])
            moves.append(chosen.force_beyond(series, raw[slip], raw[force], rows))
    return max(moves)
