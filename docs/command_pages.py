"""Tables of all options of all commands, made of the program itself."""

import typer

from swe_sphere.cli.main import COMMANDS, program


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
    parts += [f"* `{_argument(each)}`: {_sentence(each)}" for each in arguments]
    if options:
        rows = [f"| {_flags(each)} | {_cell(_sentence(each))} |" for each in options]
        parts.append("\n".join(["| option | meaning |", "|---|---|", *rows]))
    return "\n\n".join(parts)


def _argument(argument):
    return argument.name.upper() if argument.required else f"[{argument.name.upper()}]"


def _flags(option):
    """Return the names of an option with the form of its value."""
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    form = _cell(option.metavar or "NUMBER")
    return names if option.is_flag else f"{names[:-1]} {form}`"


def _sentence(parameter):
    default = parameter.default
    is_number = isinstance(default, int | float) and not isinstance(default, bool)
    words = " ".join((parameter.help or "").replace("\\[", "[").split())
    return f"{words} Default: {default:g}." if is_number else words


def _cell(text):
    return text.replace("|", "\\|")
