"""The commands of ``tirefit`` by name; the module of each is imported when it is used."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from tirefit import __version__

COMMANDS = {
    "demo": "Fit and diagnose measured samples that ship with tirefit.",
    "fit": "Fit a model to measurements: parameters with intervals, figures, report.",
    "convert": "Convert a Magic Formula to a brush.",
    "export": "Write a tire as source code or as a file of another program.",
    "explore": "Write a page with sliders: forces, friction ellipse, stiffness and peak of tires.",
    "replay": "Predict measured drives of a car from its tires; report the error over time.",
    "diagnose": "Find the effects that explain the gap between a model or simulator and data.",
    "compare": "Compare fits, .tir files or diagnoses: what differs beyond its error.",
    "estimate": "Estimate friction and stiffness at each row, from the rows up to it.",
    "brake": "Simulate braking with a controller: stopping distance, friction used, figures.",
    "prepare": "Cut the recording of a test rig into sweeps and bins, filter it, and write the"
    " rows to fit.",
    "models": "List the models: parameters, units, bounds, meaning, source equation.",
    "methods": "List the online methods: inputs, estimates, valid range of used friction, source.",
    "inspect": "Show how a file was read, and how well it determines the parameters of models.",
    "derive": "Compute slip angle and lateral force of an axle from vehicle logs.",
    "predict": "Compute the forces of a fit or a model for each row of a data file.",
    "simulate": "Simulate logs and rig sweeps whose true tire is known.",
}
"""Name -> first paragraph of its help, for the list of the commands."""

_MODULES = dict.fromkeys(("models", "methods", "inspect", "derive", "predict"), "tables")
"""Name -> module, where it is not of the same name."""

_STYLE: dict[str, Any] = {"rich_markup_mode": None, "pretty_exceptions_enable": False}

_WRONG_USE: Any = typer.BadParameter.__base__  # of all errors in arguments and options


@contextmanager
def _with_remedy(command: str) -> Iterator[None]:
    """Print an error of typer, such as an unknown option, like one of ours: with a remedy.

    Args:
        command: what is called, if the error does not know it.
    """
    try:
        yield
    except _WRONG_USE as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            raise
        from tirefit.cli.options import errors_to_exit
        from tirefit.results import UsageError, did_you_mean

        called = error.ctx.command_path if error.ctx else command
        unknown, param = getattr(error, "option_name", ""), getattr(error, "param", None)
        message = error.message if unknown else error.format_message()
        reason, _, near = " ".join(message.split()).rstrip(".?").partition(". Did you mean ")
        remedy = did_you_mean(unknown, getattr(error, "possibilities", None) or ())
        remedy += f"did you mean {near}? " if near else ""
        remedy += f"{param.get_error_hint()}: {param.help}; " if param else ""
        remedy += f"`{called} --help` lists what it takes"
        with errors_to_exit():
            raise UsageError(f"{called}: {reason[0].lower()}{reason[1:]}", remedy) from None


class Commands(TyperGroup):
    """The list of the commands."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        with _with_remedy("tirefit"):
            return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: Any) -> Any:
        with _with_remedy(f"tirefit {' '.join(ctx._protected_args)}"):
            return super().invoke(ctx)


app = typer.Typer(
    name="tirefit",
    cls=Commands,
    epilog="Exit codes: 0 ok, 2 usage, 3 data, 4 not converged, 5 not identified"
    " (with --strict), 6 friction rests on the shape of the model, 130 interrupted.",
    no_args_is_help=True,
    **_STYLE,
)


class LazyCommand(TyperCommand):
    """A command of the list, whose module is imported when it is used."""

    def loaded(self) -> Any:
        """The command itself, or the group of commands."""
        assert self.name is not None
        module = import_module(f"tirefit.cli.commands.{_MODULES.get(self.name, self.name)}")
        command = getattr(module, self.name)
        if not isinstance(command, typer.Typer):
            from tirefit.cli.options import errors_to_exit  # imported with the command

            function = errors_to_exit()(command)
            command = typer.Typer(add_completion=False, **_STYLE)
            command.command(self.name)(function)
        return typer.main.get_command(command)

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        from tirefit.cli.options import CONTEXT, errors_to_exit  # imported with the command

        command = self.loaded()
        with errors_to_exit():
            _refuse_second_value(command, args)
        context = command.make_context(info_name, args, parent, **extra)
        CONTEXT.set(context)
        return context


def _refuse_second_value(command: Any, args: list[str]) -> None:
    """Raises UsageError for ``FILE --holdout A B``, of which B would be one more FILE."""
    from tirefit.results import UsageError  # imported with the command

    for place in (k for k, word in enumerate(args) if word == "--holdout"):
        value, second = [*args[place + 1 : place + 3], "-", "-"][:2]
        if second.startswith("-"):
            continue
        parser = command.make_parser(typer.Context(command))
        before = parser.parse_args(args[:place])[0]
        if any(before.get(p.name) for p in command.params if p.param_type_name == "argument"):
            reason = f"{second} after --holdout {value}: held out, or one more to diagnose?"
            remedy = f"to hold out both: --holdout {value} --holdout {second}; to diagnose it:"
            raise UsageError(reason, f"{remedy} name it before --holdout")


for _name, _help in COMMANDS.items():
    app.command(_name, cls=LazyCommand, help=_help, short_help=_help)(lambda: None)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"tirefit {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_print_version, help="print the version"),
    ] = False,
) -> None:
    """Fit tire models to measured slip and force, and find what they miss."""
    del version  # the callback has printed it
