"""`python -m swe_sphere` is `swe-sphere`."""

from swe_sphere.cli import main

if __name__ == "__main__":
    main()
