"""Reading the TOML files of the user."""

import tomllib
from pathlib import Path
from typing import Any

from swe_sphere.errors import ConfigError


def read_toml(path: Path) -> dict[str, Any]:
    """The table in the file.

    Raises:
        ConfigError: the file is not there, cannot be read or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:  # also of text that is not UTF-8, and of endless numbers
        raise ConfigError(f"{path} is not valid TOML: {error}") from None
    except RecursionError:
        raise ConfigError(f"{path} is nested too deeply") from None
