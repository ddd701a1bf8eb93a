"""A page for each effect of the diagnosis, from its record, with a figure."""

from effect_figures import figures

from tirefit.diagnosis.effects import EFFECTS, NOISE_EFFECTS, effects_by_id
from tirefit.report.diagnosis_words import name_of, needs_text

FOLDER = "docs/effects"
KNOWN = effects_by_id(EFFECTS)
DECIDES = {
    "mz": "the aligning moment",
    "speeds": "several speeds",
    "loads": "several loads",
    "random order": "the settings in random order",
    "pure slip": "pure slip: the other slip held at zero",
    "both signs": "both signs of the slip",
    "two ramp rates": "sweeps of the slip at two rates",
    "opposite camber": "the opposite camber",
}
"""Measurement that separates an effect from those that it resembles."""
PER = {
    "slip": "times the slip at half of the largest force",
    "sliding": "over the range of the sliding speed",
    "rolling": "over the range of the speed",
    "growth": "times the slip at half of the largest force, over the range of the speed",
    "inverse_speed": "times the slip at half of the largest force, over the range of 1/v",
    "period": "times the time in which the slip changes by its standard deviation",
    "way": "times the distance in which the slip changes by its standard deviation",
    "temperature": "over the range of the temperature in 20 K",
    "lever": "times the length that changes the slip by the slip at half of the largest"
    " force, at the usual yaw rate over speed",
    "inertia": "times the inertia of the carried mass at the rolling radius",
    "swing": "times what changes the force by the load at the usual yaw acceleration",
}
"""What a prior is relative to, by the name of the size of the file that is its unit."""


def pages():
    """Path -> content of every page and figure."""
    found = {}
    for effect, (figure, amplitude) in figures().items():
        found[f"{FOLDER}/{effect}.md"] = _page(KNOWN[effect], amplitude)
        found[f"{FOLDER}/{effect}.png"] = figure
    return found


def table():
    """The table of all effects, and of the laws of the noise."""
    heads = ["| effect | family | cause |", "|---|---|---|"]
    rows = [f"| {_link(e.id)} | {e.family} | {e.means} |" for e in EFFECTS]
    rows += [f"| {name_of(e.id)} | {e.family} | {e.means} |" for e in NOISE_EFFECTS]
    return "\n".join(heads + rows)


def _link(effect):
    return f"[{name_of(effect)}]({effect}.md)"


def _page(effect, amplitude):
    name, unit = name_of(effect.id), effect.unit.removeprefix("-")
    unit = f" {unit.strip()}" if unit else ""
    relative = PER.get(effect.per[0], unit.strip())
    rows = {
        "id": f"`{effect.id}`",
        "family": effect.family,
        "formula": f"`{effect.formula}`",
        "prior of the amplitude": f"standard deviation {effect.scale:g} {relative}",
        "variants tried": f"{len(effect.variants)} of the formula",
        "forces that change": ", ".join(f"`{c}`" for c in effect.channels) or "all",
        "needs": needs_text(effect.needs) or "slip, force, load",
        "resembles": ", ".join(map(_link, effect.looks_like)) or "none of the others",
        "measure to decide": DECIDES.get(effect.told_apart_by, "no single measurement"),
    }
    cells = "\n".join(f"| {head} | {cell} |" for head, cell in rows.items())
    return f"""# {name.capitalize()}

What it means that `tirefit diagnose` names **{name}**, and what to do.

- **Cause**: {effect.means}.
- **What to do**: {effect.remedy}.

![force without and with {name}]({effect.id}.png)

Left: force over load against slip, without (grey) and with the effect (blue), on a
simulated record; the amplitude is {amplitude:.3g}{unit}. Right: the change that it
makes.

| | |
|---|---|
{cells}
"""
