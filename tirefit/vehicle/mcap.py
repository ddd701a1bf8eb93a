"""A replay as an MCAP file, which Foxglove and PlotJuggler show: :func:`recorded`."""

import io
import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from tirefit import __version__
from tirefit.results import InputProblem, UsageError

if TYPE_CHECKING:
    from tirefit.vehicle.replay import Replay

NAMES = {
    "x": "x_m",
    "y": "y_m",
    "heading": "heading_rad",
    "yaw_rate": "yaw_rate_rad_per_s",
    "v_y": "v_y_m_per_s",
    "a_y": "a_y_m_per_s2",
}
"""Quantity -> its name in the messages."""

_SCHEMA = {
    "type": "object",
    "description": "SI units; angles and speeds positive to the left",
    "properties": {name: {"type": "number"} for name in NAMES.values()},
}
_NANO = 1e9


def writers() -> tuple[Any, Any]:
    """The modules ``mcap.writer`` and ``mcap.well_known``; UsageError if they are not installed."""
    try:
        from mcap import well_known, writer
    except ImportError:
        reason = "writing MCAP needs mcap, which is not installed"
        raise UsageError(InputProblem(reason, "pip install 'tirefit[logs]' (or mcap)")) from None
    return writer, well_known


def recorded(replay: "Replay") -> bytes:
    """The measured and the predicted motion of each log as channels of JSON messages.

    ``/LOG/measured`` has the motion of the log at every sample, ``/LOG/predicted_500_ms_ahead``
    the prediction for the time of each message that started half a second before it: one channel
    for each horizon.

    Returns:
        The content of the file, with the time of the log [ns] as the time of each message; a log
        that begins before zero begins at zero.
    """
    writer, well_known = writers()
    file = io.BytesIO()
    out = writer.Writer(file)
    out.start(profile="", library=f"tirefit {__version__}")
    text = json.dumps(_SCHEMA).encode()
    schema = out.register_schema("tirefit.motion", well_known.SchemaEncoding.JSONSchema, text)
    for log, fans in replay.fans.items():
        base = fans.epoch - min(fans.epoch + float(np.nanmin(fans.time)), 0.0)
        step = fans.time[0, 1] - fans.time[0, 0]
        channels = {"measured": (fans.measured, slice(None))} | {
            f"predicted_{1000 * h:.0f}_ms_ahead": (fans.predicted, [round(h / step)])
            for h in replay.horizons
        }
        for topic, (series, columns) in channels.items():
            times = fans.time[:, columns]
            # Windows overlap: each sample once.
            stamps, once = np.unique(np.round((times + base) * _NANO), return_index=True)
            values = np.stack([series[name][:, columns].ravel()[once] for name in NAMES], axis=1)
            known = np.isfinite(stamps)
            if not known.any():
                continue
            name = f"/{re.sub('[^A-Za-z0-9_]', '_', log)}/{topic}"
            channel = out.register_channel(name, well_known.MessageEncoding.JSON, schema)
            for at, row in zip(stamps[known].astype(int).tolist(), values[known], strict=True):
                pairs = zip(NAMES.values(), row.tolist(), strict=True)
                message = {key: value for key, value in pairs if np.isfinite(value)}
                out.add_message(channel, at, json.dumps(message).encode(), at)
    out.finish()
    return file.getvalue()
