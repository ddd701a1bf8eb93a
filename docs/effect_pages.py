"""A page for each effect of the diagnosis, from its record, with a figure."""

import car_figures
import effect_figures

from tirefit.diagnosis.effects import EFFECTS, NOISE_EFFECTS, effects_by_id
from tirefit.report.diagnosis.words import name_of, needs_text
from tirefit.vehicle.effects import CAR_EFFECTS

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


_OF_MOTION = {"yaw_rate", "yaw_acceleration", "heading", "a_x", "a_y", "steering"}
_NEEDS = {
    "acceleration": "an acceleration that varies",
    "speeds": "speeds that vary",
    "heading": "a log with the pose",
    "rates": "a log with the yaw rate",
}
"""Needs of the effects of a car, in words."""
_FORCES = """Above: force over load without (grey) and with the effect (blue), on the sweep or
stretch of a simulated record that it changes most. Below: the difference, in the whole record."""
_CAR = """Above: the motion of a simulated car without (grey) and with the effect (blue), at the
same steering and speed. Below: the difference."""


def pages():
    """Path -> content of every page and figure."""
    found = {}
    for folder, library, shown, text in (
        (FOLDER, KNOWN, effect_figures.figures(), _FORCES),
        (f"{FOLDER}/car", effects_by_id(CAR_EFFECTS), car_figures.figures(), _CAR),
    ):
        for effect, (figure, amplitude) in shown.items():
            page = _page(library[effect], amplitude, text, "car" in folder)
            found[f"{folder}/{effect}.md"] = page
            found[f"{folder}/{effect}.png"] = figure
    return found


def group_of(effect):
    """Title of the group of an effect of an axle's forces."""
    if effect.of == "vehicle" or _OF_MOTION & {*effect.needs}:
        return "Motion"
    return effect.of.capitalize()


def _table(effects, folder=""):
    rows = [f"| {_link(e.id, folder)} | {e.means} |" for e in effects]
    return "\n".join(["| effect | cause |", "|---|---|", *rows])


def table(group):
    """The table of the effects of a group."""
    if group == "Car":
        return _table(CAR_EFFECTS, "car/")
    if group == "Noise":
        rows = [f"| {name_of(e.id)} | {e.means} |" for e in NOISE_EFFECTS]
        return "\n".join(["| law of the noise | meaning |", "|---|---|", *rows])
    return _table([e for e in EFFECTS if group_of(e) == group])


def _link(effect, folder=""):
    return f"[{name_of(effect)}]({folder}{effect}.md)"


def _page(effect, amplitude, text, of_car):
    name, unit = name_of(effect.id), effect.unit.removeprefix("-")
    unit = f" {unit.strip()}" if unit else ""
    relative = PER.get(effect.per[0], unit.strip())
    decides = effect.told_apart_by if of_car else DECIDES.get(effect.told_apart_by)
    command = "tirefit diagnose --vehicle" if of_car else "tirefit diagnose"
    needs = ", ".join(_NEEDS[one] for one in effect.needs) if of_car else needs_text(effect.needs)
    rows = {
        "id": f"`{effect.id}`",
        "family": effect.family,
        "formula": f"`{effect.formula}`",
        "prior of the amplitude": f"standard deviation {effect.scale:g} {relative}",
        "variants tried": f"{len(effect.variants)} of the formula",
        "forces that change": ", ".join(f"`{c}`" for c in effect.channels) or "all",
        "needs": needs or ("a log and `vehicle.toml`" if of_car else "slip, force, load"),
        "resembles": ", ".join(map(_link, effect.looks_like)) or "none of the others",
        "measure to decide": decides or "no single measurement",
    }
    if of_car:
        del rows["forces that change"]
    cells = "\n".join(f"| {head} | {cell} |" for head, cell in rows.items())
    return f"""# {name.capitalize()}{" of a car" * of_car}

What it means that `{command}` names **{name}**, and what to do.

- **Cause**: {effect.means}.
- **What to do**: {effect.remedy}.

![without and with {name}, and the difference]({effect.id}.png)

{text} The amplitude is {amplitude:.3g}{unit}.

| property | of {name} |
|---|---|
{cells}
"""
