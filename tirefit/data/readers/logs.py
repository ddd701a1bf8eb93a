"""Read logs of vehicles as tables: MDF by asammdf, MCAP and ROS bags by rosbags.

The channels have different clocks. The table uses the clock that has most of the known
channels. Other channels are interpolated to it, and are NaN in gaps and beyond their
ends. A column ``time`` [s] counts from the first sample.
"""

import logging
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.columns import IsKnown
from tirefit.data.readers.extras import extra, readable
from tirefit.data.readers.mat import Channels
from tirefit.data.readers.remote import Place
from tirefit.results import DataError

MDF = b"MDF     "  # first bytes of a finished file (.mf4, .mdf)
_BAGS = {b"\x89MCAP0": ".mcap", b"SQLite format 3": ".db3", b"#ROSBAG": ".bag"}
_LARGEST_MESSAGE = 4096
"""Largest message [bytes] that is read; larger ones are images or point clouds."""
_LONGEST_ARRAY = 16
_REMEDY = "close the recording properly, or export it as CSV"
_GAP = 5.0  # largest gap between two samples, in periods of their channel, that is interpolated


class Signal(NamedTuple):
    """A channel on its own clock: (n,) times [s] and values, and its unit."""

    time: np.ndarray
    values: np.ndarray
    unit: str = ""


def bag_suffix(content: bytes) -> str:
    """The file ending for these bytes: that of MCAP or a ROS bag, else ""."""
    fits = (end for start, end in _BAGS.items() if content.startswith(start))
    return next(fits, "")


def channels_of_mdf(path: Place, content: bytes, is_known: IsKnown) -> Channels:
    """The numeric channels of an MDF file on one clock, conversions applied.

    Raises:
        DataError: asammdf is missing, or the file is damaged or empty.
    """
    asammdf = extra("asammdf", "MDF files", str(path), "logs")
    # Suppress what asammdf logs on a damaged file: the error below reports it.
    logging.getLogger("asammdf").setLevel(logging.CRITICAL + 1)
    signals: dict[str, Signal] = {}
    left = []
    with readable("MDF file", str(path), _REMEDY):
        with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
            warnings.simplefilter("ignore")
            copy = Path(folder) / "log.mf4"  # asammdf maps the file that it reads
            copy.write_bytes(content)
            with asammdf.MDF(copy) as mdf:
                for channel in mdf.iter_channels():
                    values, name = np.asarray(channel.samples), channel.name
                    if values.ndim != 1 or values.dtype.kind not in "fiub":
                        left.append(f"{name!r} (no numbers)")
                    elif name in signals:
                        left.append(f"{name!r} (again)")
                    elif len(values):
                        time = np.array(channel.timestamps, float)
                        signals[name] = Signal(time, values.astype(float), channel.unit or "")
    channels = on_one_clock(signals, is_known, str(path))
    unread = [f"channels not read: {', '.join(left)}"] if left else []
    return channels._replace(notes=("read as a log of MDF", *channels.notes, *unread))


def channels_of_bag(path: Place, content: bytes, is_known: IsKnown) -> Channels:
    """The numeric fields of the messages of a bag on one clock, as ``/topic.field``; ``content``
    is empty for the folder of a ROS 2 bag.

    The clock of a topic is that of the stamps in its headers if it has them, else that
    of the recording. Messages are decoded by the definitions in the bag; a topic that
    cannot be decoded is left out, with a note.

    Raises:
        DataError: rosbags is missing, or the bag is damaged or empty.
    """
    highlevel = extra("rosbags.highlevel", "MCAP and ROS bags", str(path), "logs")
    from rosbags.typesys import Stores, get_typestore

    signals: dict[str, Signal] = {}
    left: list[str] = []  # topics that are not read, with the reason
    with readable("bag", str(path), _REMEDY):
        with tempfile.TemporaryDirectory() as folder:
            place = Path(str(path))
            if content:
                place = Path(folder) / f"log{bag_suffix(content)}"
                place.write_bytes(content)
            types = get_typestore(Stores.LATEST)  # of a bag without definitions
            with highlevel.AnyReader([place], default_typestore=types) as reader:
                for topic in sorted({connection.topic for connection in reader.connections}):
                    connections = [c for c in reader.connections if c.topic == topic]
                    try:
                        read = _topic(reader, connections, topic)
                    except Exception as error:  # rosbags raises many kinds
                        kinds = " or ".join({c.msgtype for c in connections})
                        why = f"{type(error).__name__}: {error}"
                        read = f"no {kinds} by its definition: {why}"
                    signals |= read if isinstance(read, dict) else {}
                    left += [f"{topic!r} ({read})"] if isinstance(read, str) else []
    unread = [f"topics not read: {', '.join(left)}"] if left else []
    if left and not signals:
        remedy = "record messages with numbers, and their definitions"
        raise DataError(unread[0], remedy, str(path))
    channels = on_one_clock(signals, is_known, str(path))
    return channels._replace(notes=("read as a bag of ROS messages", *channels.notes, *unread))


def _topic(reader: Any, connections: list[Any], topic: str) -> dict[str, Signal] | str:
    """Fields of the messages of a topic, or the reason why it has none to read."""
    recorded: list[float] = []
    stamped: list[float] = []
    rows: list[dict[str, float]] = []
    for connection, nanoseconds, raw in reader.messages(connections):
        if len(raw) > _LARGEST_MESSAGE:
            return f"messages of {len(raw)} bytes"
        message = reader.deserialize(raw, connection.msgtype)
        recorded.append(nanoseconds / 1e9)
        stamped.append(_stamp(message))
        rows.append(dict(_fields(message)))
    names = list(dict.fromkeys(name for row in rows for name in row))
    time = np.array(stamped if min(stamped, default=0) > 0 else recorded)
    columns = {n: np.array([row.get(n, np.nan) for row in rows]) for n in names}
    named = {f"{topic}.{name}": Signal(time, x) for name, x in columns.items()}
    return named or ("no numbers" if rows else "no messages")


def _stamp(message: Any) -> float:
    """Time of a header, or of a message's own header [s]; 0 without one."""
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    return 0.0 if stamp is None else stamp.sec + stamp.nanosec / 1e9


def _fields(message: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Numbers of a message by the path to each; short arrays by their index."""
    for name in getattr(message, "__dataclass_fields__", {}):
        value: Any = getattr(message, name)
        path = f"{place}.{name}" if place else name
        if path == "header.stamp":
            yield path, _stamp(message)
        elif isinstance(value, bool | int | float | np.number):
            yield path, float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            if value.size <= _LONGEST_ARRAY:
                flat = enumerate(value.reshape(-1))
                yield from ((f"{path}[{i}]", float(number)) for i, number in flat)
        elif hasattr(value, "__dataclass_fields__") and name != "stamp":
            yield from _fields(value, path)


def on_one_clock(signals: dict[str, Signal], is_known: IsKnown, file: str) -> Channels:
    """Signals by name as columns, on the clock that most of the known ones have.

    Raises:
        DataError: there are no signals.
    """
    if not signals:
        reason, remedy = "the log holds no channels of numbers", "record some"
        raise DataError(reason, remedy, file)
    clocks: dict[bytes, float] = {}
    for name, signal in signals.items():
        weight = 1 + 1000 * is_known(name) + 1e-9 * len(signal.time)
        key = signal.time.tobytes()
        clocks[key] = clocks.get(key, 0.0) + weight
    best = max(clocks, key=clocks.__getitem__)
    base = np.frombuffer(best, float)
    columns = {"time": base - base[0]}
    units = {"time": "s"} | {n: signal.unit for n, signal in signals.items() if n != "time"}
    moved = []
    for name, signal in signals.items():
        if name != "time":
            is_base = signal.time.tobytes() == best
            columns[name] = signal.values if is_base else _moved(signal, base)
            moved += [] if is_base else [repr(name)]
    notes = [f"time counts from {base[0]:.9g} s of the log"]
    if moved:
        notes.append(
            f"interpolated to the clock of the others, no further than {_GAP:g} of"
            f" their own samples apart: {', '.join(moved)}"
        )
    known = {n: text for n, text in units.items() if text}
    return Channels(columns, known, (*notes,), float(base[0]))


def _moved(signal: Signal, base: np.ndarray) -> np.ndarray:
    """Values at the times ``base`` (n,), NaN beyond the ends and within gaps."""
    order = np.argsort(signal.time, kind="stable")
    time, values = signal.time[order], signal.values[order]
    moved = np.interp(base, time, values, left=np.nan, right=np.nan)
    if len(time) < 2:
        return np.where(base == time[0], moved, np.nan)
    steps = np.diff(time)
    after = np.clip(np.searchsorted(time, base), 1, len(time) - 1)
    in_gap = steps[after - 1] > _GAP * np.median(steps)
    return np.where(in_gap & ~np.isin(base, time), np.nan, moved)
