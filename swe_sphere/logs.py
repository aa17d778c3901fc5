"""Lines about runs: all of them go to Python's logger `swe_sphere`.

The program prints lines from the level INFO up on stderr.  DEBUG has the beginning and the end of
each run, and progress where a bar shows it.
"""

import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import translate_errors

LOGGER = logging.getLogger("swe_sphere")
LOGGER.addHandler(logging.NullHandler())  # or Python would print warnings a second time


class _OnStderr(logging.StreamHandler):  # type: ignore[type-arg]
    """Prints lines as the program does; a closed stderr or a full disk loses them."""

    def format(self, record: logging.LogRecord) -> str:
        kind = "warning: " if record.levelno == logging.WARNING else ""
        return f"swe-sphere: {kind}{record.getMessage()}"

    def handleError(self, record: logging.LogRecord) -> None:
        pass


@contextmanager
def print_lines(level: int = logging.INFO) -> Iterator[None]:
    """Print lines from a level up on stderr in the block, in the place of an outer block."""
    handler = _OnStderr(sys.stderr)
    handler.setLevel(level)
    others = [each for each in LOGGER.handlers if not isinstance(each, _OnStderr)]
    before, LOGGER.handlers = LOGGER.handlers, [*others, handler]
    level_before = LOGGER.level
    LOGGER.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        LOGGER.handlers = before
        LOGGER.setLevel(level_before)


@contextmanager
def append_lines(path: Path | None) -> Iterator[None]:
    """Append lines with time and level to a file, if given; inside `print_lines` all lines.

    Raises ConfigError if the file cannot be written, or exists and is not a log.
    """
    if path is None:
        yield
        return
    with translate_errors(f"cannot write {path}"):
        if path.is_file():
            with path.open("rb") as file:
                if not re.match(rb"\d{4}-\d\d-|$", file.read(8)):
                    raise ConfigError(f"log: {path} exists and is not a log: choose another name")
        handler = logging.FileHandler(path, encoding="utf-8")
    handler.handleError = lambda record: None  # type: ignore[method-assign]
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    LOGGER.addHandler(handler)
    try:
        yield
    except Exception as error:
        LOGGER.debug("failed: %s", error)
        raise
    finally:
        LOGGER.removeHandler(handler)
        with suppress(OSError):  # the disk is full
            handler.close()
