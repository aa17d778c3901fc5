"""What `--help` prints is what the commands say of themselves, units in brackets included."""

import pytest
import typer

from swe_sphere.cli.main import main, program

COMMANDS = typer.main.get_command(program()).commands


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_prints_every_text_whole(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    printed = " ".join(capsys.readouterr().out.split())
    assert end.value.code == 0 and "None" not in printed
    texts = [parameter.help for parameter in COMMANDS[name].params if parameter.help]
    for text in (COMMANDS[name].help.partition("\n")[0], *texts):
        assert " ".join(text.replace("\\[", "[").split()) in printed


def test_without_arguments_the_help_is_all_that_is_printed(capsys):
    with pytest.raises(SystemExit) as end:
        main([])
    printed = capsys.readouterr()
    assert (end.value.code, printed.err) == (2, "") and "Usage: swe-sphere" in printed.out
