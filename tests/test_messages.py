"""Every text that the program can print is listed in one file, where a person can read it."""

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from swe_sphere.cli.main import COMMANDS

SOURCES = Path(__file__).parents[1]
LIST = Path(__file__).with_name("data") / "messages.txt"
RENEW = "python tests/test_messages.py"
SENTENCE = re.compile(r"[A-Za-z}\]]{2,}[,;:)]? [(\[]?[a-zA-Z{'`]{2,}")
"""Texts of at least two words; shorter ones are names and keys."""
CODE = re.compile(r"[;{]\n|return |const |number\{|&r\)|::|__")
"""Parts of C++ code, which the kernels contain."""
HELP = "use_attribute_docstrings"
"""Setting of pydantic's models whose attributes have their help as docstrings."""


def text_of(node: ast.AST) -> str | None:
    """Return a literal text, with the names of inserted values in braces."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if not isinstance(node, ast.JoinedStr):
        return None
    parts = []
    for part in node.values:
        if isinstance(part, ast.Constant):
            parts.append(str(part.value))
        else:
            shown = part.value if isinstance(part, ast.FormattedValue) else part
            name = shown.attr if isinstance(shown, ast.Attribute) else getattr(shown, "id", "…")
            parts.append(f"{{{name}}}")
    return "".join(parts)


def texts(path: Path) -> Iterator[str]:
    """Yield the texts of a module: literals, help of options and docstrings of commands."""
    source = path.read_text("utf-8")
    tree, silent = ast.parse(source), set()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        is_help = HELP in source or "RunConfig)" in source
        for place, statement in enumerate(body if isinstance(body, list) else ()):
            if isinstance(statement, ast.Expr) and text_of(statement.value) is not None:
                name = f"{path.stem}:{getattr(node, 'name', '')}"
                is_option = place > 0 and is_help and isinstance(node, ast.ClassDef)
                if not (is_option or (place == 0 and name in COMMANDS.values())):
                    silent.add(id(statement.value))
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        if id(node) in silent:
            continue
        if (text := text_of(node)) is not None:
            yield text
        else:
            pending += reversed([*ast.iter_child_nodes(node)])


@cache
def listing() -> str:
    """Return the list of all texts, by module."""
    lines = [
        "Every text that the program can print: messages, warnings, headings and help.",
        f"Renewed by: {RENEW}",
    ]
    for folder in ("kernels", "testcases", "swe_sphere"):
        for path in sorted((SOURCES / folder).rglob("*.py")):
            found = [text for text in texts(path) if SENTENCE.search(text)]
            shown = [" ".join(text.split()) for text in found if not CODE.search(text)]
            if shown:
                lines += ["", path.relative_to(SOURCES).as_posix(), *dict.fromkeys(shown)]
    return "\n".join(lines) + "\n"


def test_the_list_of_messages_is_up_to_date():
    assert listing() == LIST.read_text("utf-8"), f"renew the list: {RENEW}"


def test_messages_use_plain_words():
    """Idiom that the style guide replaces does not return."""
    idiom = re.compile(r"\b(go(es)? on|blows? up|anew|asked for|dear|hangs on|tells?|knows)\b")
    assert not [line for line in listing().splitlines() if idiom.search(line)]


if __name__ == "__main__":
    LIST.write_text(listing(), "utf-8")
    sys.stdout.write(f"{LIST}\n")
