"""Tables of all options of all commands, made of the program itself."""

import typer

from swe_sphere.cli.main import COMMANDS, program
from swe_sphere.simulation.config import RunConfig
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

MODELS = {"run": RunConfig, "ensemble": RunConfig, "sweep": SweepPlan}
"""Classes that contain the defaults of the options of a command."""


def write_command_tables(file):
    """Write a section with a table of options for each command; an unchanged file stays."""
    group = typer.main.get_command(program())
    text = "\n\n".join(_section(name, group.commands[name]) for name in COMMANDS) + "\n"
    if not file.exists() or file.read_text() != text:
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)


def _section(name, command):
    parameters = [each for each in command.params if each.name != "help"]
    arguments = [each for each in parameters if each.param_type_name == "argument"]
    options = [each for each in parameters if each.param_type_name == "option"]
    words = [_argument(each) for each in arguments]
    usage = " ".join(["swe-sphere", name, *words, *(["[OPTIONS]"] if options else [])])
    parts = [f"### {name}", command.help.strip(), f"    {usage}"]
    fields = MODELS[name].model_fields if name in MODELS else {}
    parts += [f"* `{_argument(each)}`: {_sentence(each, fields)}" for each in arguments]
    if options:
        rows = [f"| {_flags(each)} | {_cell(_sentence(each, fields))} |" for each in options]
        parts.append("\n".join(["| option | meaning |", "|---|---|", *rows]))
    return "\n\n".join(parts)


def _argument(argument):
    return argument.name.upper() if argument.required else f"[{argument.name.upper()}]"


def _flags(option):
    """Return the names of an option with the form of its value."""
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    form = _cell(option.metavar or "NUMBER")
    return names if option.is_flag else f"{names[:-1]} {form}`"


def _sentence(parameter, fields):
    default = parameter.default
    if default is None and parameter.name in fields:
        default = fields[parameter.name].default
    words = " ".join((parameter.help or "").replace("\\[", "[").split())
    if "default" in words.lower() or not isinstance(default, int | float | str):
        return words
    return words if isinstance(default, bool) else f"{words} Default: {default}."


def _cell(text):
    return text.replace("|", "\\|")
