"""The command line: thin; everything it does is also a function of the package."""

import sys

__all__ = ["main"]


def main() -> None:
    """The program `swe-sphere`; Ctrl-C ends it with one line even while it is still loading."""
    try:
        from swe_sphere.cli.main import main as program

        program()
    except KeyboardInterrupt:
        sys.stderr.write("swe-sphere: interrupted by Ctrl-C\n")
        sys.exit(130)
