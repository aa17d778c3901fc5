"""The model against exact tendencies, and its book-keeping."""

from __future__ import annotations

import gc
import sys
import weakref
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support import make_scene, random_state, tendency

from swe_sphere.equations.effects import Tracers, Viscosity
from swe_sphere.equations.model import Model
from swe_sphere.equations.right_hand_side import RightHandSide
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.operators import Launcher
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.planet import EARTH
from swe_sphere.solvers.gravity_waves import explicit_radii
from swe_sphere.testcases import get_scene

FULL = ("advection", "pressure", "rotation", "orography", "viscosity", "hyperviscosity")


def residuals(scene, ne: int, np_: int, t: float = 0.0) -> np.ndarray:
    """Largest error of each block's tendency [m s-2, m s-2, m s-1], or [m s-1] for depth alone.

    The exact tendency is a fourth-order difference in time of the exact solution.
    """
    mesh = Mesh.build(ne, np_)
    model = Model(mesh, scene)

    def exact(time):
        fields = dict(zip("uvh", scene.exact(mesh.lon, mesh.lat, time), strict=True))
        return np.concatenate([fields[name] for name in model.names])

    step = 20.0
    near, far = (exact(t + s * step) - exact(t - s * step) for s in (1, 2))
    expected = (8.0 * near - far) / (12.0 * step)
    error = np.abs(tendency(model, exact(t), t) - expected).reshape(len(model.names), -1)
    return error.max(axis=1)


def test_steady_flow_has_no_tendency() -> None:
    """williamson2 over the corners of the cube: spectral convergence in np."""
    scene = get_scene("williamson2", alpha=np.pi / 4)
    force, spread = 2.0 * EARTH.rotation * 38.6, 3000.0 * 38.6 / EARTH.radius
    scales = [force, force, spread]  # of what must cancel
    errors = [(residuals(scene, 2, np_) / scales).max() for np_ in (4, 6, 8, 12)]
    assert errors[0] < 0.05 and errors[-1] < 2e-7
    assert all(fine < coarse / 10 for coarse, fine in pairwise(errors))


def test_steady_flow_converges_with_the_elements() -> None:
    """Pointwise at the order of the derivative, np - 1, less what the seams of elements cost."""
    errors = np.array([residuals(get_scene("williamson2"), ne, 4) for ne in (4, 8, 16)])
    assert np.all(np.log2(errors[:-1] / errors[1:]) > 2.3)


@pytest.mark.parametrize("t", [0.0, 20000.0])
def test_unsteady_flow_over_orography(t: float) -> None:
    """lauter: the tendency is the time derivative of the exact solution, with all of dynamics."""
    scene = get_scene("lauter")
    coarse, fine = residuals(scene, 2, 7, t), residuals(scene, 2, 12, t)
    assert np.all(fine < [1e-10, 1e-10, 5e-8])
    assert np.all(fine < 1e-2 * coarse)


@pytest.mark.parametrize("alpha", [0.0, np.pi / 4, np.pi / 2])
def test_transport_by_a_prescribed_wind(alpha: float) -> None:
    scene = get_scene("williamson1", alpha=alpha, gaussian=True)
    coarse, fine = residuals(scene, 2, 8), residuals(scene, 2, 16)
    assert fine[0] < 5e-10 and fine[0] < 1e-3 * coarse[0]


def test_coriolis_turns_the_wind_to_the_right_in_the_north(small_mesh) -> None:
    """du/dt = f v, dv/dt = -f u, whatever the depth."""
    scene = make_scene("rotation")
    model = Model(small_mesh, scene)
    state = random_state(model)
    u, v, _ = state.reshape(3, -1)
    du, dv, dh = tendency(model, state).reshape(3, -1)
    f = scene.coriolis(small_mesh.lon, small_mesh.lat)
    np.testing.assert_allclose(du, f * v, rtol=1e-14)
    np.testing.assert_allclose(dv, -f * u, rtol=1e-14)
    assert not dh.any()


@pytest.mark.parametrize("shape", ["element", "node"])
def test_the_same_tendency_twice_is_the_same_to_the_last_bit(small_mesh, shape) -> None:
    models = [Model(small_mesh, make_scene(*FULL), shape=shape) for _ in range(2)]
    state = random_state(models[0])
    results = [tendency(model, state).tobytes() for model in (*models, *models)]
    assert len(set(results)) == 1


def test_numbering_of_nodes_does_not_matter(small_mesh) -> None:
    """Nodes in another order give the same tendencies, to the last bit."""
    new = np.random.default_rng(3).permutation(small_mesh.size)  # new number of each old node
    old = np.argsort(new)
    contributors = np.split(small_mesh.gather_entries, small_mesh.gather_offsets[1:-1])
    counts = np.diff(small_mesh.gather_offsets)[old]
    nodal = {name: getattr(small_mesh, name)[old] for name in ("xyz", "lon", "lat", "area")}
    shuffled = replace(
        small_mesh,
        **nodal,
        east=small_mesh.east[old],
        north=small_mesh.north[old],
        nodes=new[small_mesh.nodes].astype(np.int32),
        gather_offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        gather_entries=np.concatenate([contributors[i] for i in old]),
    )
    scene = make_scene(*FULL)
    model, other = Model(small_mesh, scene), Model(shuffled, scene)
    state = random_state(model)
    expected = tendency(model, state).reshape(3, -1)[:, old]
    moved = np.ascontiguousarray(state.reshape(3, -1)[:, old]).ravel()
    np.testing.assert_array_equal(tendency(other, moved).reshape(3, -1), expected)


def test_parts_add_up_to_the_whole(small_mesh) -> None:
    model = Model(small_mesh, make_scene(*FULL))
    state = model.device_mesh.upload(random_state(model))
    whole, dynamics, dissipation = (model.zeros() for _ in range(3))
    model.tendency(state, 0.0, whole)
    model.conservative_tendency(state, 0.0, dynamics)
    model.dissipative_tendency(state, dissipation)
    total = dynamics.numpy() + dissipation.numpy()
    scale = np.repeat(np.abs(whole.numpy()).reshape(3, -1).max(axis=1), small_mesh.size)
    assert np.abs((total - whole.numpy()) / scale).max() < 1e-12
    assert model.counters["rhs_evaluations"] == 2


def test_state_and_fields_are_inverse(small_mesh) -> None:
    model = Model(small_mesh, make_scene("advection", "pressure"))
    u, v, h = random_state(model).reshape(3, -1)
    fields = model.fields(model.state_from(u, v, h))
    for name, values in zip("uvh", (u, v, h), strict=True):
        np.testing.assert_array_equal(fields[name], values)


def test_prescribed_wind_is_in_the_fields_and_leaves_depth_alone(small_mesh) -> None:
    scene = make_scene("wind")
    model = Model(small_mesh, scene)
    assert model.names == ("h",) and model.size == small_mesh.size
    fields = model.fields(model.initial_state(), 0.5)
    np.testing.assert_array_equal(fields["u"], scene.wind(small_mesh.lon, small_mesh.lat, 0.5)[0])


def test_vorticity_of_solid_body_rotation() -> None:
    """ζ = 2 ω sin θ for u = ω a cos θ."""
    mesh = Mesh.build(3, 8)
    zeta = vorticity(mesh, EARTH.radius * np.cos(mesh.lat), np.zeros(mesh.size))
    np.testing.assert_allclose(zeta, 2.0 * np.sin(mesh.lat), atol=1e-5)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"precision": "float16"}, "float64 or float32"),
        ({"shape": "row"}, "element or node"),
        ({"device": "cuda:77"}, "no device"),
        ({"device": "gpu"}, "no device"),
    ],
)
def test_bad_choices_say_what_there_is(small_mesh, options, word) -> None:
    with pytest.raises(ConfigError, match=word):
        Model(small_mesh, make_scene("pressure"), **options)


@pytest.mark.parametrize(
    ("value", "words"), [(np.nan, "not finite"), (-10.0, "is -10 m"), (0.0, "is 0 m")]
)
def test_a_start_that_makes_no_sense_is_refused(small_mesh, value: float, words: str) -> None:
    base = get_scene("williamson5")

    def initial(lon, lat):
        u, v, h = base.initial(lon, lat)
        return u, v, np.where(np.arange(h.size) == 5, value, h)

    with pytest.raises(ConfigError, match=rf"initial (h|depth).*{words}.*at longitude"):
        Model(small_mesh, replace(base, initial=initial)).initial_state()


def test_a_wind_that_changes_needs_a_depth_without_waves_too(small_mesh) -> None:
    base = make_scene("advection")
    scene = replace(base, initial=lambda lon, lat: (0.0 * lat, 0.0 * lat, np.sin(lat)))
    with pytest.raises(ConfigError, match=r"initial depth is -0.996 m at longitude"):
        Model(small_mesh, scene).initial_state()


def test_a_passive_depth_may_be_nothing(small_mesh) -> None:
    """The bell of williamson1 stands on dry ground."""
    model = Model(small_mesh, get_scene("williamson1"))
    assert model.fields(model.initial_state())["h"].min() == 0.0


def test_a_bottom_that_is_no_number_is_refused(small_mesh) -> None:
    scene = replace(get_scene("williamson5"), bottom=lambda lon, lat: np.log(lat))
    with pytest.raises(ConfigError, match=r"bottom.*not finite"):
        Model(small_mesh, scene)


def test_more_numbers_than_places_can_tell_are_refused() -> None:
    """They are of 32 bits, and numpy would cut them short without a word."""
    mesh = Model(Mesh.build(1, 3), get_scene("williamson2")).device_mesh
    with pytest.raises(ConfigError, match=r"fields .* have more than 2\^31 numbers"):
        mesh.places(10**8)


@pytest.mark.parametrize("scene", ["williamson5", "matsuno", "williamson4"])
@pytest.mark.parametrize("launches", ["unrecorded", "recorded"])
def test_a_right_hand_side_is_two_frames_above_its_launches(small_mesh, scene, launches) -> None:
    """The function between is an operator; also of a stage of a step."""
    model = Model(small_mesh, get_scene(scene))
    rhs = model.right_hand_side(stage=(model.zeros(), 1.0))
    model.launch.records = launches == "recorded"
    x, out, names = model.initial_state(), model.zeros(), []

    def trace(frame, event, argument) -> None:
        if event == "call" and frame.f_code is Launcher.__call__.__code__:
            path = [frame.f_code.co_qualname]
            while (frame := frame.f_back).f_code is not RightHandSide.__call__.__code__:
                # launches under other names: a sum of vectors, the runs of a span, all elements
                if frame.f_code.co_name not in ("combine", "launch_all", "over_elements"):
                    path.append(frame.f_code.co_qualname)
            names.append(path)

    for _ in range(3):
        sys.setprofile(trace)
        rhs(x, 0.0, out)
        sys.setprofile(None)
    assert names and all(len(path) == 2 for path in names), names


def test_models_of_fewer_effects_share_arrays_and_counters(small_mesh) -> None:
    model = Model(small_mesh, make_scene(*FULL))
    for other in (model.inviscid, model.flux_model, model.flux_model.inviscid):
        assert other.parameters is model.parameters and other.counters is model.counters
        assert other.scratch("laplacian") is model.scratch("laplacian")
        out, before = other.zeros(), model.counters["rhs_evaluations"]
        other.conservative_tendency(other.initial_state(), 0.0, out)
        assert model.counters["rhs_evaluations"] == before + 1
    assert not model.inviscid.diffusive and model.inviscid.inviscid is model.inviscid


def test_nothing_keeps_the_arrays_of_a_model_that_is_gone() -> None:
    """A second simulation in a process must not find the memory of the first one occupied."""
    model = Model(Mesh.build(2, 4), get_scene("williamson5"))
    model.tendency(model.initial_state(), 0.0, model.zeros())
    mesh = weakref.ref(model.device_mesh)
    del model
    gc.collect()
    assert mesh() is None


def test_tracers_that_diffuse_have_no_stages() -> None:
    scene = get_scene("deformational").with_effect(Viscosity(1e5))
    model = Model(Mesh.build(2, 4), scene)
    with pytest.raises(ConfigError, match="viscosity of tracers cannot be added in stages"):
        model.right_hand_side(stage=(model.zeros(), 60.0))


def test_tracers_that_the_scene_lacks_are_refused(small_mesh) -> None:
    model = Model(small_mesh, make_scene("advection", "pressure"))
    ones = np.ones(small_mesh.size)
    with pytest.raises(ValueError, match="has no tracers dust"):
        model.state_from(ones, ones, ones, dust=ones)


def test_tracers_may_have_the_names_of_wind_and_depth(small_mesh) -> None:
    scene = replace(dry_at_a_pole(False), tracers={"h": lambda lon, lat: 1.0})
    model, ones = Model(small_mesh, scene), np.ones(small_mesh.size)
    ratio = model.fields(model.state_from(ones, ones, ones, h=2.0 * ones))["q_h"]
    assert (ratio == 2.0).all()


def test_spectra_count_no_evaluations(small_mesh) -> None:
    model = Model(small_mesh, get_scene("williamson2"))
    model.spectral_radii(state := model.initial_state())
    explicit_radii(model, state)
    assert model.counters["rhs_evaluations"] == 0


def test_a_held_rate_needs_no_edge_penalty(small_mesh) -> None:
    model = Model(small_mesh, get_scene("williamson2"))
    held = model.zeros(2 * small_mesh.size)
    assert model.unpenalised(held).held is held and model.unpenalised() is model


def dry_at_a_pole(limiter: bool):
    return replace(
        make_scene("wind"),
        effects=(*make_scene("wind").effects, Tracers(limiter=limiter)),
        initial=lambda lon, lat: (0.0 * lat, 0.0 * lat, np.maximum(np.sin(lat), 0.0)),
        tracers={"dust": lambda lon, lat: 1.0},
    )


@pytest.mark.filterwarnings("error")
def test_without_depth_there_is_no_mixing_ratio(small_mesh) -> None:
    model = Model(small_mesh, dry_at_a_pole(False))
    ratio = model.fields(model.initial_state())["q_dust"]
    assert (
        np.isnan(ratio[small_mesh.lat < 0.0]).all() and (ratio[small_mesh.lat > 0.0] == 1.0).all()
    )


def test_a_limiter_needs_a_positive_depth(small_mesh) -> None:
    with pytest.raises(ConfigError, match=r"tracers\.limiter needs a positive depth"):
        Model(small_mesh, dry_at_a_pole(True)).tracers.limiter()
