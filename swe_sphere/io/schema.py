"""Types and ranges of data read from files of runs, checked before objects are built from them."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, Field, PositiveFloat

from swe_sphere.errors import ConfigError
from swe_sphere.io.layout import MESH_ATTRIBUTES
from swe_sphere.mesh import Mesh
from swe_sphere.settings.values import validated

Count = Annotated[int, Field(ge=0, lt=2**53)]


class RunAttributes(BaseModel, strict=True, allow_inf_nan=False):
    """Attributes of a run that are read again, if present; other attributes are not checked."""

    ne: Count = 1
    np: Count = 3
    radius: PositiveFloat = 1.0
    stretch: PositiveFloat = 1.0
    centre: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.0, 0.0]
    spin: float = 0.0
    dt: PositiveFloat = 1.0
    steps_at_once: Annotated[Count, Field(ge=1)] = 1
    start_step: Count = 0
    scene: str = ""
    title: str = ""
    run_id: str = ""
    history: str = ""
    code: str = ""
    summary: str = ""
    identity: str = ""
    configuration: str = ""
    plot_field: str = ""


class CheckpointHeader(BaseModel, strict=True, allow_inf_nan=False):
    """Header of a checkpoint; unknown entries raise an error where the checkpoint is built."""

    time: Annotated[float, Field(ge=0.0)]
    steps: Count
    stepper: str
    arrays: list[str]
    attributes: RunAttributes


def mesh_of(attributes: Mapping[str, Any], nodes: int, failure: str) -> Mesh:
    """Return the mesh of a file that has these attributes and this number of nodes.

    Raises ConfigError, which begins with `failure`, if the attributes do not describe a mesh or
    describe one of another size. The size is checked before the mesh is built.
    """
    values = {name: attributes[name] for name in MESH_ATTRIBUTES}
    ne, np = values["ne"], values["np"]
    try:
        validated(RunAttributes, values)
        if (expected := 6 * (ne * (np - 1)) ** 2 + 2) != nodes:
            raise ConfigError(
                f"ne={ne} and np={np} make {expected} nodes, and it has {nodes}: it holds a part of"
                " the nodes, or is damaged"
            )
        return Mesh.build(**values)
    except ConfigError as error:
        raise ConfigError(f"{failure}: {error}") from None
