"""Entry point of `python -m swe_sphere`, which runs `swe-sphere`."""

from swe_sphere.cli import main

if __name__ == "__main__":
    main()
