"""Errors of one file against another on any grids: `swe-sphere compare A.nc B.nc`."""

import os

import numpy as np

from swe_sphere.errors import ConfigError
from swe_sphere.files.fingerprints import SCENE_FILE
from swe_sphere.io.integrals import norms
from swe_sphere.io.layout import MESH_ATTRIBUTES
from swe_sphere.io.reference_solution import Reference, reference_field
from swe_sphere.io.runfile import TOLERANCE, RunFile, Source, reading, table_in
from swe_sphere.io.scalar_fields import check_field


def open_source(path: str | os.PathLike[str]) -> RunFile | Reference:
    """Return a file of a run, or a reference on a latitude-longitude grid, whichever it is.

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
    """Return norms of A - B over those of B, at the points and with the area weights of B.

    a, b: files of runs (any two meshes) or latitude-longitude references. field: a name in
    `scalar_fields.FIELDS` or the files, or "wind" for the vector; None: "h", or "surface" if one of
    the two contains no depth. time [s]: the frame; None: the time of a reference, otherwise the
    last one that both runs have. across_scenes: permits runs of different scenes. Returns field,
    time, l1, l2, linf. Raises ConfigError if a file cannot be read, if one of them lacks the field
    or a frame at that time, or if the runs are of different scenes.
    """
    ours, theirs = open_source(a), open_source(b)
    if not across_scenes:
        _check_scenes(ours, theirs)
    time = _common_time(ours, theirs) if time is None else time
    field = _common_field(ours, theirs, field)
    runs = isinstance(ours, RunFile) and isinstance(theirs, RunFile)
    if runs and all(ours.attributes[x] == theirs.attributes[x] for x in MESH_ATTRIBUTES):
        found = ours.values(field, time)  # no interpolation: equal files have no error
    else:
        found = ours.at(field, *theirs.points, time)
    return {"field": field, "time": time, **norms(theirs.area, found, theirs.values(field, time))}


def _check_scenes(ours: Source, theirs: Source) -> None:
    """Raise ConfigError for runs of different scenes; a reference does not name its scene."""
    one, other = (source.attributes.get("scene") for source in (ours, theirs))
    # fingerprints of user-defined scene files; scenes of the package have none
    files = [table_in(str(s.attributes.get("sources"))).get(SCENE_FILE) for s in (ours, theirs)]
    if None in (one, other) or (one == other and files[0] == files[1]):
        return
    what = f"{ours.path} and {theirs.path} are runs of two scenes named {one}"
    if one != other:
        what = f"{ours.path} is a run of {one}, {theirs.path} one of {other}"
    raise ConfigError(f"{what}: compare runs of one scene, or give --across-scenes")


def _common_time(*sources: Source) -> float | None:
    """Return the last time [s] of which both have a frame; None for references without a time."""
    timed = [s.times for s in sources if s.times.size or isinstance(s, RunFile)]
    if not timed:
        return None
    common = timed[0][np.isclose(timed[0][:, None], timed[-1], 0.0, TOLERANCE).any(axis=1)]
    if not common.size:
        names = " and ".join(str(source.path) for source in sources)
        raise ConfigError(f"{names} have no common time: give --time")
    return float(common[-1])


def _common_field(ours: Source, theirs: Source, field: str | None) -> str:
    references = [s for s in (ours, theirs) if isinstance(s, Reference)]
    if field is None:
        return "surface" if any("h" not in r.fields for r in references) else "h"
    field = check_field(field, [*ours.about, *theirs.about], vector=True)
    bottom = next((s.bottom for s in (ours, theirs) if isinstance(s, RunFile)), None)
    for reference in references:
        field = reference_field(reference, field, bottom)
    return field
