"""The figure: delay of the detection against false alarms."""

from pathlib import Path

from tirefit.report.canvas import COLORS, DARK, GREY, Picture, tidy

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
    picture = Picture(figsize=(8.2, 3.4), layout="constrained")
    panels = picture.subplots(1, len(uses), sharex=True, sharey=True, squeeze=False)[0]
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
        axes.set_title(f"{100 * use:.0f} % of the peak", fontsize=9)
        tidy(axes, "false alarms an hour", "delay [s]" if use == uses[0] else "")
        axes.grid(color=GREY, linewidth=0.3)
    for method, style in STYLES.items():
        label = f"on surprises of {method}"
        panels[-1].plot([], [], style, color=DARK, linewidth=0.8, label=label)
    panels[-1].legend(fontsize=7, frameon=False)
    picture.savefig(path, dpi=85)
