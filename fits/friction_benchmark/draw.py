"""The figure: delay of the detection against false alarms."""

from pathlib import Path

from tirefit.report.canvas import COLORS, DARK, GREY, WIDE, Picture, legend_below, panel_title, tidy

__all__ = ["draw"]

_MARKS = ("o", "s", "^", "D")
STYLES = {"ekf": "-", "rls": ":"}
"""Line style by the method that supplies the surprises."""


def draw(lines: list[dict[str, str]], path: Path) -> None:
    """Median delay of a drop to 0.6 against false alarms, one panel per use of friction.

    Args:
        lines: rows of detectors.csv; hollow marks are thresholds that miss a drop.
    """
    uses = sorted({float(line["use"]) for line in lines})
    picture = Picture(figsize=(WIDE, 1 + 2.2 * len(uses)), layout="constrained")
    panels = picture.subplots(len(uses), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    colors = [DARK, *COLORS]
    for axes, use in zip(panels, uses, strict=True):
        here = [line for line in lines if float(line["use"]) == use]
        for k, detector in enumerate(dict.fromkeys(one["detector"] for one in here)):
            for method, style in STYLES.items():
                rows = [
                    line
                    for line in here
                    if (line["detector"], line["surprise_of"]) == (detector, method)
                ]
                if not rows:
                    continue
                # No alarm in T hours is drawn as half an alarm.
                false = [max(float(r["false_per_hour"]), 0.5 / float(r["hours"])) for r in rows]
                delay = [float(r["delay_60"]) for r in rows]
                color = colors[k]
                axes.plot(false, delay, style, color=color, linewidth=0.8)
                for x, y, row in zip(false, delay, rows, strict=True):
                    whole = float(row["found_60"]) == 1
                    axes.plot(
                        x,
                        y,
                        _MARKS[k],
                        color=color,
                        markersize=4,
                        markerfacecolor=color if whole else "white",
                    )
                if method == "ekf":
                    axes.plot([], [], _MARKS[k], color=color, label=detector)
        axes.set_xscale("log")
        panel_title(axes, f"{100 * use:.0f} % of the peak")
        tidy(axes, "false alarms an hour" if axes is panels[-1] else "", "delay [s]")
        axes.grid(color=GREY, linewidth=0.3)
    for method, style in STYLES.items():
        label = f"on surprises of {method}"
        panels[-1].plot([], [], style, color=DARK, linewidth=0.8, label=label)
    legend_below(picture, panels[-1].get_legend_handles_labels()[0])
    picture.savefig(path)
