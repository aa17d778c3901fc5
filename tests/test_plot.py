"""Pictures: the map projection, what is drawn, and what is said when it cannot be."""

import functools
import re
from pathlib import Path

import numpy as np
import pytest
from cartopy.mpl.gridliner import Gridliner
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.quiver import Quiver
from PIL import Image
from support import Frame

from swe_sphere import open_run
from swe_sphere.analysis.regrid import regrid_file
from swe_sphere.errors import ConfigError
from swe_sphere.io.growing import RECORDS_AT
from swe_sphere.io.netcdf import FrameWriter
from swe_sphere.io.reference_solution import Exact, Reference, compare
from swe_sphere.io.runfile import RunFile
from swe_sphere.io.scalar_fields import FIELDS
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.sphere import frame, position
from swe_sphere.pictures import plot
from swe_sphere.pictures.drawing import Drawing, contours, limits
from swe_sphere.pictures.look import PROJECTIONS, Look
from swe_sphere.pictures.maps import grid_of, new_map, place
from swe_sphere.pictures.panels import draw_panel, panels
from swe_sphere.pictures.plot import draw_state, new_figure, plot_file, size
from swe_sphere.planet import DAY, EARTH
from swe_sphere.settings.values import validate
from swe_sphere.testcases import get_scene


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
            series = {"mass_drift": 1e-15 * day, "energy_drift": -5e-7 * day, "l2_h": 1e-5 * day}
            writer.write(
                day * DAY, fields | {"vorticity": 1e-5 * wave, "divergence": 0.0 * wave}, series
            )
    return path


def colours(path):
    return imread(path)[..., :3].reshape(-1, 3)


@pytest.mark.parametrize("field", ["h", "surface", "b", "u", "v", "speed", "vorticity"])
@pytest.mark.thorough
def test_every_field_gives_a_picture(run, tmp_path, field):
    look = Look(panel=field == "h")  # the series are the same under all of them
    picture = plot_file(run, field, out=tmp_path / f"{field}.png", look=look)
    assert picture == tmp_path / f"{field}.png"
    red, green, blue = np.round(100.0 * colours(picture)).astype(int).T
    assert len(np.unique((red * 101 + green) * 101 + blue)) > 300


def test_a_still_field_is_drawn_too(run, tmp_path):
    found = colours(plot_file(run, "divergence", out=tmp_path / "still.png"))
    assert found.std() > 0.01


@pytest.mark.parametrize(("ending", "begins"), [
    ("png", b"\x89PNG"), ("svg", b"<?xml"),
    pytest.param("pdf", b"%PDF", marks=pytest.mark.thorough),
])  # fmt: skip
def test_the_ending_says_the_format(run, tmp_path, ending, begins):
    picture = plot_file(run, "h", out=tmp_path / f"a.{ending}", look=Look(panel=False))
    assert picture.read_bytes().startswith(begins)


@pytest.mark.parametrize("look", [
    {"projection": "lat-lon", "region": (0.0, 360.0, -30.0, 30.0)},
    pytest.param({"projection": "equal-earth"}, marks=pytest.mark.thorough),
    pytest.param({"projection": "lat-lon"}, marks=pytest.mark.thorough),
    {"projection": "south-polar"},
])  # fmt: skip
def test_the_caption_lies_below_the_labels_and_above_the_scale(run, look):
    figure, look = new_figure(), Look(**look)
    axes = new_map(figure, look)
    figure.set_size_inches(*size(axes))
    Drawing(RunFile(run), "h", look, grid_of(axes, 91)).draw(axes, DAY)
    FigureCanvasAgg(figure).draw()
    (lines,) = axes.findobj(Gridliner)
    caption = next(text for text in axes.texts if text.get_text().startswith("Contours"))
    box = caption.get_window_extent()
    boxes = [label.get_window_extent() for label in lines.label_artists if label.get_visible()]
    assert boxes and not any(box.overlaps(label) for label in boxes)
    (scale,) = (other for other in figure.axes if other is not axes)
    assert scale.get_window_extent().y1 < box.y0


def test_the_frame_asked_for_is_drawn(run, tmp_path):
    look = Look(panel=False)
    early, late = (
        plot_file(run, "h", day * DAY, tmp_path / f"{day}.png", look=look) for day in (1, 2)
    )
    assert not np.array_equal(colours(early), colours(late))


@pytest.mark.thorough
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


def test_drifts_are_those_since_the_start_of_the_scene(tmp_path):
    """Also in a file that begins later, with a restart."""
    mesh = Mesh.build(1, 4)
    fields = dict.fromkeys(("h", "u", "v", "vorticity", "divergence"), np.ones(mesh.size))
    with FrameWriter(tmp_path / "run.nc", mesh, {}) as writer:
        for day in (1.0, 2.0):
            series = {"mass": 3.0 + 3e-6 * day, "mass_drift": 1e-6 * day}
            writer.write(day * DAY, fields, series)
    (drifts,) = panels(RunFile(writer.path))
    np.testing.assert_allclose(drifts.curves["mass"], [1e-6, 2e-6])


def test_no_series_no_panels(tmp_path):
    mesh = Mesh.build(1, 4)
    one = np.ones(mesh.size)
    with FrameWriter(tmp_path / "run.nc", mesh, {}) as writer:
        writer.write(0.0, dict.fromkeys(("h", "u", "v", "vorticity", "divergence"), one))
    assert panels(RunFile(tmp_path / "run.nc")) == []
    assert plot_file(tmp_path / "run.nc", "h").exists()


def test_what_cannot_be_drawn(run, tmp_path):
    for arguments, reason in (
        ({"field": "temperature"}, "unknown field"),
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


def drawing_of(source, field, look, rows, time=None, **others):
    """A drawing on a map of its own: the drawing and the map."""
    axes = new_map(new_figure(), look)
    drawing = Drawing(source, field, look, grid_of(axes, rows), **others)
    if time is not None:
        drawing.draw(axes, time)
    return drawing, axes


def test_stereographic_keeps_angles_and_orthographic_is_seen_from_outside():
    for name, lat in (("north-polar", 1.0), ("south-polar", -1.0)):
        axes = new_map(new_figure(), Look(projection=name, centre=(20.0, 0.0)))
        d = 1e-5
        x, y = place(
            axes, np.array([0.3, 0.3 + d / np.cos(lat), 0.3]), np.array([lat, lat, lat + d])
        ).T
        east, north = (np.array([x[k] - x[0], y[k] - y[0]]) / d for k in (1, 2))
        lengths = np.hypot(*east), np.hypot(*north)
        assert east @ north == pytest.approx(0.0, abs=1e-3 * lengths[0] * lengths[1])
        assert lengths[0] == pytest.approx(lengths[1], rel=1e-5)
        assert east[0] * north[1] - east[1] * north[0] > 0.0  # not a mirror image
        x, y = place(axes, np.radians([20.0]), np.array([lat]))[0]
        assert (x, np.sign(y)) == (pytest.approx(0.0, abs=1e-6), -np.sign(lat))
    axes = new_map(new_figure(), Look(projection="orthographic"))
    x, y = place(axes, np.array([0.5, 2.0, 0.0]), np.array([0.3, 0.0, 0.0])).T / EARTH.radius
    np.testing.assert_allclose(x, [np.cos(0.3) * np.sin(0.5), np.nan, 0.0], atol=1e-9)
    np.testing.assert_allclose(y, [np.sin(0.3), np.nan, 0.0], atol=1e-9)


@pytest.mark.parametrize("name", PROJECTIONS)
@pytest.mark.parametrize("centre", [(0.0, 0.0), (200.0, 35.0)])
def test_grids_lie_where_their_points_are_placed(name, centre):
    """But for the corners beyond the globe, which have points of its edge."""
    axes = new_map(new_figure(), Look(projection=name, centre=centre))
    lon, lat, x, y = grid_of(axes, 31)
    size = np.ptp(x)
    away = np.abs(place(axes, lon, lat) - np.stack([x, y], axis=-1)).max(axis=-1) / size
    assert np.mean(away < 1e-8) > 0.7
    middle = np.hypot(x - x.mean(), y - y.mean()) < 0.2 * size
    assert away[middle].max() < 1e-8
    assert np.ptp(x) == pytest.approx(np.ptp(axes.get_xlim()))


def test_a_polar_map_ends_at_its_latitude():
    for name, region in (("north-polar", (0, 360, 30, 90)), ("south-polar", (0, 360, -90, -30))):
        axes = new_map(new_figure(), Look(projection=name, region=region))
        lon, lat, x, _ = grid_of(axes, 41)
        np.testing.assert_allclose(np.degrees(np.abs(lat)).min(), 30.0, atol=2.0)
        rim = place(axes, lon * 0.0 + 1.0, np.sign(lat) * np.radians(30.0))
        np.testing.assert_allclose(np.hypot(rim[..., 0], rim[..., 1]), x.max())


@pytest.mark.parametrize("name", ["lat-lon", "equal-earth", "robinson"])
def test_a_region_fills_the_map(name):
    regions = (160.0, 200.0, -10.0, 30.0), (160.0, -160.0, -10.0, 30.0)
    maps = [new_map(new_figure(), Look(projection=name, region=region)) for region in regions]
    (lon, lat, x, _), again = (grid_of(axes, 11) for axes in maps)
    np.testing.assert_array_equal(lon, again.lon)
    east, north = np.degrees(lon) % 360.0, np.degrees(lat)
    assert [east.min(), east.max(), north.min(), north.max()] == pytest.approx(
        [160.0, 200.0, -10.0, 30.0], abs=1e-6 if name == "lat-lon" else 3.0
    )
    assert x.max() == pytest.approx(-x.min(), rel=2e-3)


@pytest.mark.parametrize("name", ["lat-lon", "equal-earth", "robinson"])
@pytest.mark.parametrize("north", [1.0, 5.0, 20.0])
def test_a_region_goes_all_round_within_bounded_memory(name, north):
    axes = new_map(new_figure(), Look(projection=name, region=(0.0, 360.0, -north, north)))
    lon, _, x, _ = grid_of(axes, 361)
    assert np.ptp(x) == pytest.approx(np.ptp(axes.projection.x_limits), rel=1e-3)
    assert np.degrees(np.ptp(lon % (2.0 * np.pi))) > 358.0 and x.size < 600_000


@pytest.mark.parametrize("look", [
    {"centre": (540.0, 0.0)}, {"centre": (-1e10, 0.0)}, {"region": (530.0, 550.0, 0.0, 10.0)},
    {"centre": (-400.0, 9.0), "projection": "orthographic"},
    {"centre": (720.0, 0.0), "projection": "south-polar"},
])  # fmt: skip
def test_longitudes_of_maps_may_be_any(look):
    turned = {key: (value[0] % 360.0, *value[1:]) for key, value in look.items() if key == "centre"}
    grids = [grid_of(new_map(new_figure(), Look(**each)), 11) for each in (look, look | turned)]
    np.testing.assert_array_equal(*(grid.lon for grid in grids))
    assert np.isfinite(grids[0].lon).all()


@pytest.mark.parametrize("day", [1234.25, 12345.0])
def test_titles_state_the_day_in_full(run, day):
    state = Frame(RunFile(run).mesh, RunFile(run).frame(), day * DAY, {})
    axes = draw_state(state, "h", new_map(new_figure(), Look()))
    assert axes.get_title().endswith(f"day {day:.7g}")


@pytest.mark.parametrize(("region", "labels"), [
    ((240.0, 301.0, 0.0, 20.0), {"110°W": -20.5, "100°W": -10.5, "70°W": 19.5}),
    ((170.0, -170.0, 0.0, 20.0), {"175°E": -5.0, "180°": 0.0, "175°W": 5.0}),
    ((10.0, 11.0, 0.0, 1.0), {"10.2°E": -0.3, "10.4°E": -0.1, "10.8°E": 0.3}),
])  # fmt: skip
def test_meridians_of_a_region_are_labelled_once_where_they_are(run, region, labels):
    look = Look(projection="lat-lon", region=region)
    _, axes = drawing_of(RunFile(run), "h", look, 11, DAY)
    FigureCanvasAgg(axes.figure).draw()
    (lines,) = axes.findobj(Gridliner)
    shown = [label for label in lines.label_artists if label.get_visible()]
    found = [(label.get_text(), label.get_window_extent()) for label in shown]
    for label, degrees in labels.items():
        (box,) = [box for text, box in found if text == label]
        middle, _ = axes.transData.inverted().transform((0.5 * (box.x0 + box.x1), box.y0))
        assert middle == pytest.approx(degrees, abs=0.1)


def test_arrows_are_as_long_as_they_are_apart(run):
    look = Look(
        projection="lat-lon", region=(40.0, 50.0, 0.0, 10.0), winds="arrows", contours=False
    )
    _, axes = drawing_of(RunFile(run), "h", look, 31, DAY)
    (arrows,) = (found for found in axes.collections if isinstance(found, Quiver))
    longest = np.hypot(arrows.U, arrows.V).max() / arrows.scale
    assert longest == pytest.approx(1.2 * 10.0 / 29.0, rel=1e-2)


@pytest.mark.parametrize("name", PROJECTIONS)
def test_arrows_point_where_the_wind_blows(name):
    """Solid rotation about a tilted axis: a step along an arrow is a step of the wind."""
    mesh = Mesh.build(3, 6)
    axis = position(0.6, 0.8)
    east, north = frame(mesh.lon, mesh.lat)
    wind = np.cross(axis, mesh.xyz)
    fields = {"u": 20.0 * (wind * east).sum(-1), "v": 20.0 * (wind * north).sum(-1)}
    look = Look(projection=name, centre=(200.0, 35.0), winds="arrows")
    source = Frame(mesh, {**fields, "h": 1.0 + 0.0 * mesh.lon, "b": 0.0 * mesh.lon}, 0.0, {})
    _, axes = drawing_of(source, "h", look, 31, 0.0)
    (arrows,) = (found for found in axes.collections if isinstance(found, Quiver))
    step = 1e-4 * np.ptp(axes.get_xlim()) / 20.0
    projection = axes.projection
    points = [
        position(*np.radians(projection.as_geodetic().transform_points(projection, x, y).T[:2]))
        for x, y in ((arrows.X, arrows.Y), (arrows.X + step * arrows.U, arrows.Y + step * arrows.V))
    ]
    moved, blown = points[1] - points[0], np.cross(axis, points[0])
    cosine = (moved * blown).sum(-1) / np.linalg.norm(moved, axis=-1)
    cosine /= np.linalg.norm(blown, axis=-1)
    speed = np.hypot(arrows.U, arrows.V)
    np.testing.assert_allclose(speed, 20.0 * np.linalg.norm(blown, axis=-1), atol=0.2)
    assert arrows.N > 400 and np.nanmedian(cosine) > 0.9999 and np.nanmin(cosine) > 0.98


def test_winds_that_were_not_written_are_not_drawn(tmp_path):
    mesh = Mesh.build(1, 4)
    with FrameWriter(tmp_path / "run.nc", mesh, {}, only=("h",)) as writer:
        writer.write(0.0, {"h": np.ones(mesh.size)})
    for arguments in ({"look": Look(winds="arrows")}, {"field": "speed"}, {"field": "u"}):
        with pytest.raises(ConfigError, match="the field 'u' is missing; there are b, h"):
            plot_file(tmp_path / "run.nc", **arguments)


@pytest.mark.parametrize("look", [
    {"mesh": True}, {"winds": "arrows"}, {"winds": "streamlines"}, {"colours": "viridis"},
    {"limits": (900.0, 1100.0)}, {"levels": 3}, {"contours": False},
])  # fmt: skip
def test_every_look_changes_the_picture(run, look):
    assert not np.array_equal(globe(run), globe(run, **look))


@functools.cache  # the plain one is compared with all others
def globe(run, **look):
    """The depth seen from outside, as numbers of the dots."""
    figure = Figure(figsize=(3.0, 3.0), dpi=50)
    canvas, look = FigureCanvasAgg(figure), Look(projection="orthographic", **look)
    axes = new_map(figure, look)
    Drawing(RunFile(run), "h", look, grid_of(axes, 31)).draw(axes, DAY)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


@pytest.mark.parametrize(("look", "reason"), [
    ({"projection": "mercator"}, "unknown projection"),
    ({"region": (10.0, 10.0, 0.0, 20.0)}, "a region is west,east,south,north"),
    ({"region": (0.0, 20.0, 30.0, 20.0)}, "a region is west,east,south,north"),
    ({"region": (0.0, 1e-9, 0.0, 1e-9)}, "at least 0.01 wide and high"),
    ({"region": (350.0, -10.0, -30.0, 30.0)}, "-360 < east - west <= 360"),
    ({"projection": "orthographic", "centre": (0.0, 95.0)}, "latitude of the centre must be -90"),
    ({"projection": "orthographic", "region": (0.0, 1.0, 0.0, 1.0)}, "accepts a centre but no"),
    ({"projection": "north-polar", "region": (-180.0, 180.0, -90.0, 90.0)}, "60 degrees beyond"),
    ({"limits": (2.0, 1.0)}, "low < high"), ({"limits": (0.0, 5e-324)}, "1e-300 to 1e300 apart"),
    ({"limits": (-1.7e308, 1.7e308)}, "1e-300 to 1e300 apart"),
    ({"levels": 0}, "greater than or equal to 1, got 0"),
    ({"winds": "barbs"}, "winds: must be 'arrows' or 'streamlines', got 'barbs'"),
])  # fmt: skip
def test_looks_that_cannot_be(look, reason):
    with pytest.raises(ConfigError, match=reason) as error:
        validate(Look, look)
    assert "\n" not in str(error.value)


def test_contours_leave_plateaus_and_round_off_alone():
    """A bell over a plain that ripples: the line of the plain would run all over it."""
    lon, lat = np.meshgrid(np.linspace(-3.0, 3.0, 121), np.linspace(-1.5, 1.5, 61))
    ripples = np.sin(40.0 * lon) * np.sin(40.0 * lat)
    bell = 1000.0 * np.exp(-20.0 * (lon**2 + lat**2)) + 2.0 * ripples
    levels, interval = contours(bell, FIELDS["h"], limits(bell, FIELDS["h"]))
    assert levels.size > 5 and 0.0 not in levels and interval in levels
    still = 3000.0 + 1e-9 * ripples
    assert contours(still, FIELDS["h"], limits(still, FIELDS["h"]))[0].size == 0
    sloped = 100.0 * np.cos(lat)
    levels, _ = contours(sloped, FIELDS["h"], limits(sloped, FIELDS["h"]))
    np.testing.assert_allclose(np.diff(levels), levels[1] - levels[0])
    wave = ripples + 0.0 * lon
    assert 0.0 not in contours(wave, FIELDS["u"], limits(wave, FIELDS["u"]))[0]


def test_numbers_of_the_scale_have_no_offset(run):
    fields = RunFile(run).frame()
    mesh = RunFile(run).mesh
    fields = fields | {"h": 30.0 + 1e-5 * fields["v"]}
    figure = draw_state(Frame(mesh, fields, 0.0, {}), "h").figure
    figure.canvas.draw()
    scale = figure.axes[1].xaxis
    assert scale.get_offset_text().get_text() == ""
    texts = [label.get_text() for label in scale.get_ticklabels()]
    assert len(texts) > 2 and len(set(texts)) == len(texts)


def test_the_difference_from_a_file_and_from_the_exact_solution(run, tmp_path):
    """What is drawn is the error, and nothing of a run that is right."""
    scene = get_scene("williamson2")
    mesh = Mesh.build(3, 6)
    u, v, h = scene.exact(mesh.lon, mesh.lat, 0.0)
    fields = {"u": u, "v": v, "h": h + 5.0 * np.sin(mesh.lat), "b": 0.0 * h}
    state = Frame(mesh, fields, 0.0, {})
    right, _ = drawing_of(state, "h", Look(), 31, against=Exact(scene, mesh))
    wrong = 5.0 * np.sin(right.grid.lat)
    np.testing.assert_allclose(right.values(0.0), wrong, rtol=0.0, atol=0.2)
    assert right.kind.diverging and right.kind.title == "error of fluid depth"
    same, _ = drawing_of(RunFile(run), "h", Look(), 31, against=RunFile(run))
    assert not same.values(DAY).any() and same.kind.title == "difference of fluid depth"
    with pytest.raises(ConfigError, match="no exact solution of williamson5"):
        Exact(get_scene("williamson5"), mesh)


def test_exact_vorticity_and_tracers():
    mesh = Mesh.build(3, 8)
    lon, lat = np.array([0.3, 2.0, 5.0]), np.array([0.2, -1.2, 0.7])
    steady = Exact(get_scene("williamson2"), mesh)
    speed = 2.0 * np.pi * mesh.radius / (12.0 * DAY)
    spin = 2.0 * speed / mesh.radius * np.sin(lat)
    np.testing.assert_allclose(steady.at("vorticity", lon, lat), spin, rtol=1e-4)
    assert np.abs(steady.at("divergence", lon, lat)).max() < 1e-9
    scene = get_scene("deformational")
    name, start = next(iter(scene.tracers.items()))
    back = Exact(scene, mesh).at(f"q_{name}", lon, lat, 12.0 * DAY)
    np.testing.assert_allclose(back, start(lon, lat), rtol=1e-12)
    for field, message in ((f"q_{name}", "not known at day 6"), ("q_nix", "ratio of 'nix'")):
        with pytest.raises(ConfigError, match=message):
            Exact(scene, mesh).at(field, lon, lat, 6.0 * DAY)


def test_lines_of_the_panels_are_not_cut(run):
    figure = new_figure()
    axes = figure.subplots()
    draw_panel(axes, panels(RunFile(run))[1], None)
    low, high = axes.get_ylim()
    values = np.concatenate([line.get_ydata() for line in axes.get_lines()])
    assert low < 0.9 * np.nanmin(values) and np.nanmax(values) < high


@pytest.mark.parametrize("ending", ["gif", "mp4", "GIF"])
@pytest.mark.thorough
def test_a_film_has_all_frames(run, tmp_path, monkeypatch, ending):
    monkeypatch.setattr(plot, "FILM_ROWS", 31)
    monkeypatch.setattr(plot, "FILM_DOTS_PER_INCH", 40)
    if ending == "mp4":
        imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    film = plot.animate_file(run, "h", tmp_path / f"film.{ending}")
    assert [path.name for path in tmp_path.iterdir()] == [film.name]
    if ending == "mp4":
        assert imageio_ffmpeg.count_frames_and_secs(str(film))[0] == 3
    else:
        with Image.open(film) as found:
            assert found.n_frames == 3


@pytest.mark.parametrize("ending", ["nc", "zarr"])
@pytest.mark.thorough
def test_fields_of_ones_own_are_drawn_and_compared_with_their_units(tmp_path, monkeypatch, ending):
    monkeypatch.setattr(plot, "FILM_ROWS", 31)
    mesh = Mesh.build(2, 4)
    fields = dict.fromkeys(("h", "u", "v", "vorticity", "divergence"), np.ones(mesh.size))
    about = {"pv": {"long_name": "potential vorticity", "units": "m-1 s-1"}}
    path = tmp_path / f"own.{ending}"
    with FrameWriter(path, mesh, {}, about=about, user_fields={"pv": mesh.lat}) as writer:
        for k in range(2):
            writer.write(60.0 * k, fields | {"pv": k + np.sin(mesh.lat)})
    assert plot_file(path, "pv", out=tmp_path / "pv.png").stat().st_size > 10_000
    assert plot.animate_file(path, "pv", tmp_path / "pv.gif").stat().st_size > 10_000
    grid = regrid_file(path, "latlon:31x60", tmp_path / "grid.nc")
    assert plot_file(grid, "pv", out=tmp_path / "grid.png").stat().st_size > 10_000
    assert compare(grid, path, "pv")["linf"] < 1e-2 and compare(path, path, "pv")["linf"] == 0.0
    for source in (RunFile(path), Reference(grid)):
        kind = drawing_of(source, "pv", Look(), 31)[0].kind
        assert (kind.title, kind.units) == ("potential vorticity", "m$^{-1}$ s$^{-1}$")
        assert kind.plain_units == "m⁻¹ s⁻¹"
    axes = open_run(path).swe.plot("pv")
    (label,) = (each.get_xlabel() for each in axes.figure.axes if each.get_xlabel())
    assert label == "potential vorticity [m$^{-1}$ s$^{-1}$]"
    for draw in (lambda: plot_file(path, "pw"), lambda: compare(path, path, "pw")):
        with pytest.raises(ConfigError, match=r"unknown field 'pw'; .*pv"):
            draw()


def test_a_picture_is_written_through_a_link(run, tmp_path):
    (tmp_path / "picture.png").symlink_to("blob")
    for _ in range(2):
        plot_file(run, "h", out=tmp_path / "picture.png", overwrite=True)
    assert (tmp_path / "picture.png").is_symlink()
    assert (tmp_path / "blob").read_bytes().startswith(b"\x89PNG")


def test_frames_without_values_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(plot, "FILM_ROWS", 31)
    monkeypatch.setattr(plot, "FILM_DOTS_PER_INCH", 40)
    mesh, path = Mesh.build(2, 4), tmp_path / "own.nc"
    fields = dict.fromkeys(("h", "u", "v", "vorticity", "divergence"), np.ones(mesh.size))
    about = {"pv": {"long_name": "potential vorticity", "units": "m-1 s-1"}}
    with FrameWriter(path, mesh, {}, about=about, user_fields={"pv": mesh.lat}) as writer:
        for time, value in ((0.0, np.nan), (60.0, 5.0), (120.0, 6.0)):
            writer.write(time, fields | {"pv": value + 0.0 * mesh.lat})
    film = plot.animate_file(path, "pv", tmp_path / "pv.gif", rate=30.0)
    with Image.open(film) as found:
        assert found.info["duration"] == 30  # the nearest hundredths of a second
    assert plot_file(path, "pv", 0.0, tmp_path / "pv.png").stat().st_size > 10_000
    film = plot.Film.of(RunFile(path), "pv", Look(), 8.0)
    film._draw_frame(120.0)
    (image,) = film._fig.axes[0].get_images()
    assert image.get_clim() == pytest.approx((5.0, 6.0))


def test_films_that_cannot_be_made(run, tmp_path):
    for arguments, reason in (
        ({"out": tmp_path / "film.avi"}, "ending in .mp4 or .gif"),
        ({"out": tmp_path / "film.gif", "rate": 0.0}, "frames a second, got 0.0"),
        ({"out": tmp_path / "film.GIF", "rate": "8"}, "frames a second, got '8'"),
        ({"out": tmp_path / "film.gif", "rate": 60.0}, r"0\.1 to 50 frames a second, got 60"),
        ({"field": "heat", "out": tmp_path / "film.gif"}, "unknown field"),
    ):
        with pytest.raises(ConfigError, match=reason):
            plot.animate_file(run, **arguments)
    for rate in ("8", np.nan, 0, None):
        with pytest.raises(ConfigError, match=r"0\.1 to 120 frames a second, got"):
            open_run(run).swe.animate("h", rate=rate)
    with pytest.raises(ConfigError, match="time must be a number, got 'a'"):
        open_run(run).swe.plot("h", time="a")


@pytest.mark.thorough
def test_the_python_of_the_page_runs(tmp_path, monkeypatch):
    page = (Path(__file__).parents[1] / "docs" / "howto" / "analysis.md").read_text()
    _, text = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(text.replace("ne=4, np=6", "ne=2, np=4"), {})
    assert (tmp_path / "wave.png").stat().st_size > 10_000
