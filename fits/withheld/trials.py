"""Draws trials: a tire, a design, no, one or several effects, and noise."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np

from fits.withheld.designs import DESIGNS, make_world
from fits.withheld.effects import EFFECTS, family_of
from fits.withheld.injected import injected, raw
from fits.withheld.measure import measure
from fits.withheld.patch import World
from fits.withheld.procedural import procedural
from fits.withheld.simulators import at_other_values, with_simulator
from fits.withheld.strange import FOREIGN, SEALED, UNLISTED, suits

__all__ = ["DEVELOPMENT", "MIXTURE", "SETS", "Trial", "draw"]

NULLS = {
    "iid": [],
    "ar1": ["noise_autocorrelated"],
    "outliers": ["outliers"],
    "heteroscedastic": ["noise_heteroscedastic"],
    "misstated": [],
    "slip_classical": ["slip_noise"],
}
DEVELOPMENT = tuple(name for name, design in DESIGNS.items() if not design.sealed)
COLUMNS = {"omega", "alpha", "gamma", "temperature", "pressure", "across"}
HIDDEN = ("unlisted", "leave_out", "foreign", "procedural", "beside")
SPARE = 0.3  # probability of each column that no effect needs
TEXTBOOK = 0.4  # probability of the textbook form


@dataclass
class Trial:
    """``truth`` are the noise-free forces, ``rig`` the text of the trial's own rig.toml.

    ``again(c, mu, factor)``: the same world, not measured, with other parameters and the
    effects' amplitudes times factor; None if not available.
    """

    columns: dict
    label: dict
    truth: dict = field(default_factory=dict)
    rig: str = ""
    again: Callable | None = None


class Draw:
    """The random choices of one trial."""

    def __init__(self, generator, designs, noises, rows, sealed):
        self.generator = generator
        self.sealed = sealed
        self.designs = designs
        self.design = self.pick(designs)
        self.noise = self.pick(noises)
        self.n = int(generator.choice(rows))

    def pick(self, choices) -> str:
        return str(self.generator.choice(list(choices)))

    def possible(self, design: str) -> list[str]:
        """Effects that a design allows; any column can be added."""
        have = DESIGNS[design].properties | COLUMNS
        return [name for name, effect in EFFECTS.items() if effect.needs <= have]

    def effect(self) -> str:
        """A random effect of all designs, each equally likely, then a design that allows it."""
        union = {e for design in self.designs for e in self.possible(design)}
        effect = self.pick(sorted(union))
        self.design = self.pick(d for d in self.designs if effect in self.possible(d))
        return effect

    def tire(self) -> World:
        g = self.generator
        c, mu = 5e4 * g.uniform(0.85, 1.15), 0.9 * g.uniform(0.9, 1.1)
        return make_world(DESIGNS[self.design], self.n, c, mu, g)

    def form(self, effect: str) -> str:
        """A random form of an effect; the last form only for sealed trials."""
        forms = list(EFFECTS[effect].forms)
        others = forms[1:] if self.sealed else forms[1:-1]
        if not others or self.generator.uniform() < TEXTBOOK:
            return forms[0]
        return self.pick(others)

    def amplitude(self, effect: str) -> float:
        about = EFFECTS[effect]
        if effect == "slip_definition":
            return 1.0
        size = about.typical * np.exp(self.generator.uniform(np.log(0.5), np.log(2)))
        return float(size * (about.sign or self.generator.choice([-1, 1])))

    def extras(self, effects) -> set[str]:
        """Columns that the effects need, and at random others."""
        needed = {need for effect in effects for need in EFFECTS[effect].needs}
        plan = DESIGNS[self.design]
        offered = ["temperature", "alpha" if plan.force == "fx" else "gamma"]
        if plan.force == "fx" and "sweeps" in plan.properties:
            offered.append("omega")
        spare = {name for name in offered if self.generator.uniform() < SPARE}
        return (needed & COLUMNS) | spare


def trial(draw: Draw, world: World, law: str, effects=(), **label) -> Trial:
    """The measurement of a world, with its label."""
    columns, truth, size = measure(world, draw.noise, law, draw.extras(effects), draw.generator)
    free = size.pop("free")
    label = {
        "effects": list(effects), "families": [family_of(e) for e in effects],
        "forms": [], "amplitudes": [], "noise_effects": [], "kind": "",
        "leave_out": None, "design": draw.design, "noise": draw.noise, "n": draw.n,
        "force": world.force, "sealed": draw.sealed, "c": world.c, "mu": world.mu,
        **size, **label,
    }  # fmt: skip
    if label["set"] in HIDDEN:
        gone = label["leave_out"]
        label["mimic_free"] = free([e for e in EFFECTS if family_of(e) == gone])
    return Trial(columns, label, truth)


def with_effects(draw: Draw, effects: list[str], **label) -> Trial:
    world = draw.tire()
    plain = deepcopy(world)
    forms, sizes, changes = [], [], []
    for effect in effects:
        form, size = draw.form(effect), draw.amplitude(effect)
        change = EFFECTS[effect].forms[form]
        changes.append((change, size, deepcopy(draw.generator)))
        change(world, size, draw.generator)
        forms, sizes = [*forms, form], [*sizes, size]
    made = trial(draw, world, "iid", effects, forms=forms, amplitudes=sizes, **label)
    return replace(made, again=at_other_values(plain, changes))


def single(draw: Draw) -> Trial:
    return with_effects(draw, [draw.effect()], set="singles")


def pair(draw: Draw) -> Trial:
    first = draw.effect()
    others = [e for e in draw.possible(draw.design) if family_of(e) != family_of(first)]
    return with_effects(draw, [first, draw.pick(others)], set="pairs")


def leave_out(draw: Draw) -> Trial:
    effect = draw.effect()
    return with_effects(draw, [effect], set="leave_out", leave_out=family_of(effect))


def null(draw: Draw) -> Trial:
    kind = draw.pick(NULLS)
    if kind == "slip_classical":
        draw.design, draw.noise = "A", "seed"
    noise = NULLS[kind]
    return trial(draw, draw.tire(), kind, set="null", kind=kind, noise_effects=noise)


def strange(draw: Draw, kinds: dict, name: str) -> Trial:
    """An unlisted effect of a random kind, in a design in which it has an influence."""
    open_to = [k for k in kinds if draw.sealed or k not in SEALED]
    fit = {k: [d for d in draw.designs if suits(k, DESIGNS[d])] for k in open_to}
    kind = draw.pick(k for k in open_to if fit[k])
    if draw.design not in fit[kind]:
        draw.design = draw.pick(fit[kind])
    size = draw.generator.uniform(0.02, 0.08) * draw.generator.choice([-1, 1])
    world = draw.tire()
    kinds[kind](world, size, draw.generator)
    return trial(draw, world, "iid", set=name, kind=kind, amplitudes=[float(size)])


def unlisted(draw: Draw) -> Trial:
    return strange(draw, UNLISTED, "unlisted")


def by_chance(draw: Draw) -> Trial:
    size = draw.generator.uniform(0.4, 1.6)
    world = draw.tire()
    kind = procedural(world, size, draw.generator)
    return trial(draw, world, "iid", set="procedural", kind=kind, amplitudes=[float(size)])


def beside(draw: Draw) -> Trial:
    """A listed and an unlisted effect."""
    effect = draw.effect()
    form, size = draw.form(effect), draw.amplitude(effect)
    world = draw.tire()
    EFFECTS[effect].forms[form](world, size, draw.generator)
    kind = procedural(world, draw.generator.uniform(0.4, 1.6), draw.generator)
    return trial(
        draw, world, "iid", [effect], forms=[form], amplitudes=[size], kind=kind, set="beside"
    )


def foreign(draw: Draw) -> Trial:
    along = [d for d in draw.designs if DESIGNS[d].force == "fx" and d != "A"]
    draw.design = draw.pick(along or ["G"])
    return strange(draw, FOREIGN, "foreign")


def simulator(draw: Draw) -> Trial:
    """A measurement as in another set, and a simulator with wrong parameters."""
    kinds = (single, single, null, by_chance)
    return with_simulator(kinds[draw.generator.integers(len(kinds))](draw), draw)


def into_data(draw: Draw) -> Trial:
    columns, label, rig = injected(draw.generator)
    return Trial(columns, label, rig=rig)


def as_measured(which: int) -> Trial:
    columns, label, rig = raw(which)
    return Trial(columns, label, rig=rig)


SETS = {
    "singles": single,
    "null": null,
    "unlisted": unlisted,
    "pairs": pair,
    "leave_out": leave_out,
    "foreign": foreign,
    "procedural": by_chance,
    "beside": beside,
    "simulators": simulator,
    "injected": into_data,
}

MIXTURE = (
    *("singles", "simulators", "null", "unlisted", "procedural") * 2,
    *("singles", "simulators", "null") * 2,
    "singles",
    "simulators",
    "foreign",
    "leave_out",
    "pairs",
    "simulators",
    "beside",
    "injected",
)
"""The order of sets for ``--set all``: a quarter simulators, more with unlisted effects."""


def draw(seed, count, sets, designs, noises, rows, sealed) -> list[Trial]:
    """``count`` trials, shuffled: sets in turn, each trial from its own random stream.

    Injected trials are accompanied by the unchanged halves of the measured file.
    """
    streams = np.random.SeedSequence(seed).spawn(count + 1)
    open_to = designs or (list(DESIGNS) if sealed else list(DEVELOPMENT))
    trials = [
        SETS[sets[k % len(sets)]](
            Draw(np.random.default_rng(stream), open_to, noises, rows, sealed)
        )
        for k, stream in enumerate(streams[:-1])
    ]
    trials += [as_measured(which) for which in (0, 1) if "injected" in sets]
    order = np.random.default_rng(streams[-1]).permutation(len(trials))
    return [trials[k] for k in order]
