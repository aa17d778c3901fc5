"""Pictures: the map projection, what is drawn, and what is said when it cannot be."""

import numpy as np
import pytest
from matplotlib.image import imread

from swe_sphere.errors import ConfigError
from swe_sphere.io.classic import RECORDS_AT
from swe_sphere.io.netcdf import FrameWriter
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh
from swe_sphere.pictures import plot
from swe_sphere.pictures.globe import equal_earth, globe_grid
from swe_sphere.pictures.panels import panels
from swe_sphere.pictures.plot import plot_file
from swe_sphere.planet import DAY


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(plot, "ROWS", 61)
    monkeypatch.setattr(plot, "DOTS_PER_INCH", 60)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two frames of a wave over a hill with series of norms and integrals."""
    path = tmp_path_factory.mktemp("plot") / "run.nc"
    mesh = Mesh.build(3, 6)
    wave = np.sin(3.0 * mesh.lon) * np.cos(mesh.lat) ** 3
    hill = 500.0 * np.exp(-10.0 * ((mesh.lat - 0.5) ** 2 + (mesh.lon - 3.0) ** 2))
    with FrameWriter(path, mesh, {"scene": "hilly", "dt": 60.0}, hill) as writer:
        for day in (0.0, 1.0, 2.0):
            fields = {"h": 1000.0 + 100.0 * day * wave, "u": 10.0 + wave, "v": wave}
            series = {"mass": 1.0 + 1e-15 * day, "energy": 2.0 - 1e-6 * day, "l2_h": 1e-5 * day}
            writer.write(
                day * DAY, fields | {"vorticity": 1e-5 * wave, "divergence": 0.0 * wave}, series
            )
    return path


def colours(path):
    return imread(path)[..., :3].reshape(-1, 3)


@pytest.mark.parametrize("field", ["h", "surface", "b", "u", "v", "speed", "vorticity"])
def test_every_field_gives_a_picture(run, tmp_path, field):
    picture = plot_file(run, field, out=tmp_path / f"{field}.png")
    assert picture == tmp_path / f"{field}.png"
    assert len(np.unique(np.round(colours(picture), 2), axis=0)) > 300


def test_a_still_field_is_drawn_too(run, tmp_path):
    found = colours(plot_file(run, "divergence", out=tmp_path / "still.png"))
    assert found.std() > 0.01


def test_the_frame_asked_for_is_drawn(run, tmp_path):
    early, late = (plot_file(run, "h", day * DAY, tmp_path / f"{day}.png") for day in (1, 2))
    assert not np.array_equal(colours(early), colours(late))


def test_pictures_beside_the_file_are_named_after_field_and_day(run):
    """So that none takes the place of another."""
    asked = {
        "run_surface.png": (), "run_u.png": ("u",), "run_v.png": ("v",),
        "run_v_day1.png": ("v", DAY),
    }  # fmt: skip
    for name, arguments in asked.items():
        assert plot_file(run, *arguments) == run.with_name(name)
    assert len({run.with_name(name).read_bytes() for name in asked}) == 4


def test_panels_hold_errors_and_drifts(run):
    errors, drifts = panels(RunFile(run))
    assert list(errors.curves) == ["$l_2$ height"]
    np.testing.assert_allclose(errors.curves["$l_2$ height"], [np.nan, 1e-5, 2e-5])
    np.testing.assert_allclose(drifts.curves["energy"], [np.nan, 5e-7, 1e-6], rtol=1e-6)
    assert list(drifts.curves) == ["mass", "energy"]


def test_no_series_no_panels(tmp_path):
    mesh = Mesh.build(1, 4)
    one = np.ones(mesh.size)
    with FrameWriter(tmp_path / "run.nc", mesh, {}) as writer:
        writer.write(0.0, dict.fromkeys(("h", "u", "v", "vorticity", "divergence"), one))
    assert panels(RunFile(tmp_path / "run.nc")) == []
    assert plot_file(tmp_path / "run.nc", "h").exists()


def test_what_cannot_be_drawn(run, tmp_path):
    for arguments, reason in (
        ({"field": "temperature"}, "there is no field"),
        ({"time": 7.5 * DAY}, "no frame at day 7.5"),
        ({"out": tmp_path / "picture.nc"}, "ending in .png"),
        ({"out": tmp_path / "missing" / "picture.png"}, "cannot write"),
    ):
        with pytest.raises(ConfigError, match=reason) as error:
            plot_file(run, **arguments)
        assert "\n" not in str(error.value)
    with pytest.raises(ConfigError, match="there is no file"):
        plot_file(tmp_path / "missing.nc")


def test_a_file_without_frames(tmp_path):
    mesh = Mesh.build(1, 4)
    frame = dict.fromkeys(("h", "u", "v", "vorticity", "divergence"), np.ones(mesh.size))
    with FrameWriter(tmp_path / "run.nc", mesh, {}) as writer:
        writer.write(0.0, frame)
    with (tmp_path / "run.nc").open("r+b") as file:
        file.seek(RECORDS_AT)
        file.write(bytes(4))
    with pytest.raises(ConfigError, match="no frame yet"):
        plot_file(tmp_path / "run.nc")


def test_the_projection_keeps_areas():
    lon, lat = globe_grid(181)
    x, y = equal_earth(lon, lat)
    east = np.stack([np.diff(x, axis=1)[:-1], np.diff(y, axis=1)[:-1]])
    north = np.stack([np.diff(x, axis=0)[:, :-1], np.diff(y, axis=0)[:, :-1]])
    area = np.abs(east[0] * north[1] - east[1] * north[0])
    exact = np.diff(np.sin(lat), axis=0)[:, :-1] * np.diff(lon, axis=1)[:-1]
    assert area.sum() == pytest.approx(4.0 * np.pi, rel=1e-2)
    middle = slice(45, -45)
    np.testing.assert_allclose(area[middle], exact[middle], rtol=2e-2)
