"""Errors of one file against another, whatever the grids: `swe-sphere compare A.nc B.nc`."""

import os

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.files.fingerprints import SCENE_FILE
from swe_sphere.io.layout import MESH_ATTRIBUTES
from swe_sphere.io.norms import norms
from swe_sphere.io.reference_solution import Reference, reference_field
from swe_sphere.io.runfile import TOLERANCE, RunFile, reading, table_in
from swe_sphere.io.scalar_fields import check_field

Source = RunFile | Reference


def open_source(path: str | os.PathLike[str]) -> Source:
    """A file of a run, or a reference on a latitude-longitude grid, whichever it is.

    Raises ConfigError if it is neither, missing or damaged.
    """
    with reading(path) as data:
        on_grid = {"lat", "lon"} <= data.sizes.keys()
    return Reference(path) if on_grid else RunFile(path)


def compare(
    a: str | os.PathLike[str],
    b: str | os.PathLike[str],
    field: str | None = None,
    time: float | None = None,
    across_scenes: bool = False,
) -> dict[str, str | float | None]:
    """Norms of A - B over those of B, at the points and with the area weights of B.

    a, b: files of runs (any two meshes) or latitude-longitude references.  field: a name in
    `scalar_fields.FIELDS` or the files, or "wind" for the vector; None: "h", or "surface" where one
    of the two holds no depth.  time [s]: the frame; None: the time of a reference, else the last
    one that both runs have.  across_scenes: also where the two are runs of different scenes.
    Returns field, time, l1, l2, linf.  Raises ConfigError if a file cannot be read, if one of them
    lacks the field or a frame at that time, or if the runs are of different scenes.
    """
    ours, theirs = open_source(a), open_source(b)
    if not across_scenes:
        _check_scenes(ours, theirs)
    time = _common_time(ours, theirs) if time is None else time
    field = _common_field(ours, theirs, field)
    errors = norms(theirs.area, _on_points_of(theirs, ours, field, time),
                   theirs.values(field, time))  # fmt: skip
    return {"field": field, "time": time, **errors}


def _check_scenes(ours: Source, theirs: Source) -> None:
    """ConfigError for runs of different scenes; a reference does not say of which it is."""
    one, other = (source.attributes.get("scene") for source in (ours, theirs))
    if None in (one, other):
        return
    if one != other:
        what = f"{ours.path} is a run of {one}, {theirs.path} one of {other}"
    elif _scene_file(ours) != _scene_file(theirs):
        what = f"{ours.path} and {theirs.path} are runs of two scenes of the name {one}"
    else:
        return
    raise ConfigError(f"{what}: compare runs of one scene, or say --across-scenes")


def _scene_file(source: Source) -> str | None:
    """Fingerprint of the file that holds the scene; None of a scene of the package."""
    return table_in(str(source.attributes.get("sources", "{}"))).get(SCENE_FILE)


def _common_time(ours: Source, theirs: Source) -> float | None:
    """The time [s] of a reference, else the last one of which both have a frame."""
    for source in (theirs, ours):
        if isinstance(source, Reference) and source.times.size:
            return source.nearest(None)
    runs = [source for source in (theirs, ours) if isinstance(source, RunFile)]
    if len(runs) < 2:
        return runs[0].nearest(None) if runs else None
    one, other = (run.times for run in runs)
    common = one[[bool(np.any(np.abs(other - time) <= TOLERANCE)) for time in one]]
    if common.size == 0:
        raise ConfigError(f"{ours.path} and {theirs.path} have no frame at one time: give --time")
    return float(common[-1])


def _common_field(ours: Source, theirs: Source, field: str | None) -> str:
    references = [s for s in (ours, theirs) if isinstance(s, Reference)]
    if field is None:
        return "surface" if any("h" not in r.fields for r in references) else "h"
    field = check_field(field, [*ours.about, *theirs.about], vector=True)
    bottoms = [s.bottom for s in (ours, theirs) if isinstance(s, RunFile)]
    for reference in references:
        field = reference_field(reference, field, bottoms[0] if bottoms else None)
    return field


def _on_points_of(target: Source, source: Source, field: str, time: float | None) -> Array:
    if _same_mesh(source, target):
        return source.values(field, time)
    return source.at(field, *target.points, time)


def _same_mesh(one: Source, other: Source) -> bool:
    """Whether two runs share their nodes: then nothing is interpolated, and equal is equal."""
    return all(isinstance(s, RunFile) for s in (one, other)) and all(
        one.attributes[name] == other.attributes[name] for name in MESH_ATTRIBUTES
    )
