"""What is solved: the effects, the scenes and the right-hand side."""

from typing import TYPE_CHECKING

from swe_sphere.equations.scene import Scene

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.equations.spectrum import Spectrum

__all__ = ["Model", "Scene", "Spectrum"]


def __getattr__(name: str) -> object:
    """Import the parts that need Warp only when they are asked for: scenes are data."""
    if name == "Model":
        from swe_sphere.equations.model import Model

        return Model
    if name == "Spectrum":
        from swe_sphere.equations.spectrum import Spectrum

        return Spectrum
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
