"""The vector space: weighted sums, orthonormalisation, and its two ways of computing."""

import math
from itertools import pairwise, product

import numpy as np
import pytest
import warp as wp

from swe_sphere.errors import ConfigError
from swe_sphere.kernels import specialise
from swe_sphere.kernels.simd.sums import tree, weighted_products
from swe_sphere.operators.chunks import branches
from swe_sphere.solvers.krylov import KrylovBasis
from swe_sphere.solvers.vector_space import DeviceSpace, HostSpace, VectorSpace

N = 9001  # neither a multiple of the spans of the host nor of the blocks of GPUs
WAYS = list(product((HostSpace, DeviceSpace), (wp.float64, wp.float32)))


@pytest.fixture(params=WAYS, ids=lambda way: f"{way[0].__name__}-{way[1].__name__}")
def space(request: pytest.FixtureRequest) -> VectorSpace:
    kind, real = request.param
    weights = np.random.default_rng(1).uniform(0.5, 2.0, N)
    return kind(weights, real=real)


def weights_of(space: VectorSpace) -> np.ndarray:
    """The weights, found from the products of unit vectors."""
    return np.random.default_rng(1).uniform(0.5, 2.0, space.n)


def vector(space: VectorSpace, values: np.ndarray) -> wp.array:
    return wp.array(values, dtype=space.real, device="cpu")


def random_stack(space: VectorSpace, rows: int, seed: int = 0) -> tuple[wp.array, np.ndarray]:
    """A stack and its values in float64."""
    stack = vector(space, np.random.default_rng(seed).standard_normal((rows, space.n)))
    return stack, stack.numpy().astype(np.float64)


def test_products_are_weighted_sums(space: VectorSpace) -> None:
    stack, values = random_stack(space, 5)
    expected = values[:4] @ (weights_of(space) * values[4])
    assert space.projections((stack, 4, stack[4])) == pytest.approx(expected, abs=1e-11)
    assert space.dot(stack[0], stack[4]) == pytest.approx(expected[0], abs=1e-11)
    pairs = [(row, stack[4]) for row in (stack[3], stack[1])]
    assert space.dots(*pairs) == pytest.approx(expected[[3, 1]], abs=1e-11)
    assert space.norm(stack[2]) == pytest.approx(
        math.sqrt(np.sum(weights_of(space) * values[2] ** 2)), rel=1e-14
    )


def test_lowest_of_a_part_and_no_number(space: VectorSpace) -> None:
    """A NaN is below all, wherever it stands; parts may be shorter than there are blocks."""
    x = random_stack(space, 1)[0][0]
    values = x.numpy()
    for begin, end in ((0, N), (3000, 6001), (17, 20), (N - 1, N)):
        assert space.lowest(x, begin, end) == values[begin:end].min()
    values[[4000, 4001]] = np.nan, -1e9
    assert space.lowest(x, 3000, 6001) == -math.inf
    assert space.lowest(x, 4001, 6001) == -1e9


def test_sums_are_accurate_when_the_vectors_are_not() -> None:
    n = 200_000
    for kind in (HostSpace, DeviceSpace):
        space = kind(np.ones(n), real=wp.float32)
        x = wp.full(n, 0.1, dtype=wp.float32, device="cpu")
        assert space.dot(x, x) == pytest.approx(n * float(np.float32(0.1)) ** 2, rel=1e-12)


def test_combinations(space: VectorSpace) -> None:
    stack, values = random_stack(space, 4)
    x, out, c = vector(space, values[3]), space.zeros(), np.array([0.5, -2.0, 3.0])
    small = 20.0 * space.epsilon
    space.combine(x, stack, c, out)
    assert out.numpy() == pytest.approx(values[3] + c @ values[:3], abs=small)
    space.combine(x, stack, c[:2], x)
    assert x.numpy() == pytest.approx(values[3] + c[:2] @ values[:2], abs=small)
    space.combine(x, stack, c[:0], out)
    assert np.array_equal(x.numpy(), out.numpy())


def test_sums_of_two_and_copies(space: VectorSpace) -> None:
    stack, values = random_stack(space, 2)
    x, y = stack[0], stack[1]
    space.axpy(-0.3, x, y)
    assert y.numpy() == pytest.approx(values[1] - 0.3 * values[0], abs=9.0 * space.epsilon)
    space.axpby(2.0, x, -1.0, y)
    expected = 2.3 * values[0] - values[1]
    assert y.numpy() == pytest.approx(expected, abs=30.0 * space.epsilon)
    space.scale(-0.5, x)
    assert np.array_equal(x.numpy(), (-0.5 * values[0]).astype(x.numpy().dtype))
    space.copy(x, y)
    space.clear(x)
    assert np.array_equal(y.numpy(), (-0.5 * values[0]).astype(x.numpy().dtype))
    assert not x.numpy().any()


def filled_basis(
    space: VectorSpace, size: int, done: int, most_loss: float | None = None
) -> tuple[KrylovBasis, np.ndarray]:
    """A basis with random rows, the first `done` of them orthonormal; and all as they were."""
    basis = KrylovBasis(space, size, most_loss=most_loss)
    rows = np.random.default_rng(0).standard_normal((size, space.n))
    np.copyto(basis.stack.numpy(), rows, casting="same_kind")
    basis.start(space.norm(basis.rows[0]))
    for count in range(1, done):
        basis.extend(count)
    return basis, rows


def gram(basis: KrylovBasis, count: int) -> np.ndarray:
    """Products of the first rows with each other."""
    space, rows = basis.space, basis.rows
    return np.array([space.projections((basis.stack, count, row)).copy() for row in rows[:count]])


def test_basis_reproduces_the_vectors(space: VectorSpace) -> None:
    basis, values = filled_basis(space, 6, 1)
    for count in range(1, 6):
        c, length = basis.extend(count)
        rows = basis.stack.numpy().astype(np.float64)
        rebuilt = c @ rows[:count] + length * rows[count]
        assert rebuilt == pytest.approx(values[count], abs=1e2 * space.epsilon)
    assert gram(basis, 6) == pytest.approx(np.eye(6), abs=10.0 * space.epsilon)


def test_basis_survives_cancellation(space: VectorSpace) -> None:
    """One pass of Gram-Schmidt would leave an error of round-off / 1e-4."""
    basis, _ = filled_basis(space, 3, 2)
    rows = basis.stack.numpy()
    rows[2] = rows[0] + rows[1] + 1e-4 * rows[2] / np.sqrt(space.n)
    before = space.norm(basis.rows[2])
    _, length = basis.extend(2)
    assert 0.0 < length < 1e-3 * before
    assert gram(basis, 3) == pytest.approx(np.eye(3), abs=50.0 * space.epsilon)


def test_basis_does_not_lose_orthogonality_little_by_little(space: VectorSpace) -> None:
    """Each vector loses some digits to the others, never so much as to call for a second pass."""
    basis, _ = filled_basis(space, 30, 1)
    for count in range(1, 30):
        rows = basis.stack.numpy()
        rows[count] = rows[:count].sum(axis=0) + 0.3 * math.sqrt(count / space.n) * rows[count]
        before = space.norm(basis.rows[count])
        _, length = basis.extend(count)
        assert 0.1 * before < length < 0.5 * before
    assert gram(basis, 30) == pytest.approx(np.eye(30), abs=2.0 * math.sqrt(space.epsilon))


@pytest.mark.parametrize("most_loss", [1e-4, 0.03])
def test_basis_loses_no_more_orthogonality_than_it_may(space: VectorSpace, most_loss) -> None:
    """The bound is right, whatever is left of a vector, and a large limit is made use of."""
    basis, random = filled_basis(space, 20, 1, most_loss)
    kept = np.sqrt(1.0 / space.n) * np.where(np.arange(20) % 5 == 4, 1e-3, 0.3)
    for count in range(1, 20):
        rows = basis.stack.numpy()
        rows[count] = rows[:count].sum(axis=0) + kept[count] * random[count]
        _, length = basis.extend(count)
        assert 0.1 * kept[count] < length / np.sqrt(space.n) < 10.0 * kept[count]
        deviation = np.linalg.norm(gram(basis, count + 1) - np.eye(count + 1), 2)
        assert deviation <= 2.0 * basis.loss + 10.0 * count * space.epsilon
        assert basis.loss <= most_loss
    default = math.sqrt(space.epsilon)
    assert most_loss < default or basis.loss > default


@pytest.mark.parametrize("remainder", [2e-3, 5e-4])
def test_basis_that_is_hardly_orthogonal_finds_what_is_left(space: VectorSpace, remainder) -> None:
    """A second pass is not enough; the remainder is neither lost nor confused with the span."""
    basis, random = filled_basis(space, 4, 3, 0.03)
    rows = basis.stack.numpy()
    rows[1] += 0.025 * rows[0]
    basis.loss = 0.03
    mine = random[3] / space.norm(wp.array(random[3], dtype=space.real, device="cpu"))
    rows[3] = rows[0] + rows[1] + rows[2] + remainder * mine
    _, length = basis.extend(3)
    assert length == pytest.approx(remainder, rel=0.1)
    assert np.abs(gram(basis, 4)[3, :3]).max() < 0.01
    rows[3] = rows[0] - rows[1]
    assert basis.extend(3)[1] == 0.0


def test_basis_knows_its_own_span(space: VectorSpace) -> None:
    basis, _ = filled_basis(space, 3, 2)
    rows = basis.stack.numpy()
    rows[2] = 3.0 * rows[0] - 4.0 * rows[1]
    assert space.norm(basis.rows[2]) == pytest.approx(5.0, rel=1e-5)
    coefficients, length = basis.extend(2)
    assert coefficients == pytest.approx([3.0, -4.0], abs=40.0 * space.epsilon)
    assert length == 0.0
    rows[2] = 0.0
    assert basis.extend(2)[1] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_shows(space: VectorSpace, bad: float) -> None:
    basis, _ = filled_basis(space, 2, 1)
    basis.stack.numpy()[1, 17] = bad
    assert not math.isfinite(space.norm(basis.rows[1]))
    assert not math.isfinite(basis.extend(1)[1])


@pytest.mark.parametrize("real", [wp.float64, wp.float32])
def test_kernels_agree_with_numpy_and_repeat_bit_by_bit(real: type) -> None:
    weights = np.random.default_rng(1).uniform(0.5, 2.0, N)
    host, device, again = (
        kind(weights, real=real) for kind in (HostSpace, DeviceSpace, DeviceSpace)
    )
    stacks = [random_stack(space, 40)[0] for space in (host, device, again)]
    found = []
    for space, stack in zip((host, device, again), stacks, strict=True):
        sums = space.projections((stack, 40, stack[7])).copy()
        space.combine(stack[1], stack, sums[:35] / N, stack[1])
        found.append(np.append(sums, space.norm(stack[1])))
    assert found[0] == pytest.approx(found[1], rel=2.0 * host.epsilon, abs=1e-11)
    difference = stacks[0].numpy() - stacks[1].numpy()
    assert np.abs(difference).max() < 50.0 * host.epsilon
    assert found[1].tobytes() == found[2].tobytes()
    assert stacks[1].numpy().tobytes() == stacks[2].numpy().tobytes()


def test_views_follow_the_memory() -> None:
    """An address that comes back with other contents, or another size, is not taken for the old."""
    space = VectorSpace(np.ones(50))
    for value in range(700):
        x = wp.full(50, float(value), dtype=wp.float64, device="cpu")
        assert space.dot(x, x) == 50.0 * value**2
        del x
    with pytest.raises(TypeError, match="50"):
        space.norm(wp.zeros(49, dtype=wp.float64, device="cpu"))
    with pytest.raises(TypeError, match="float64"):
        space.norm(wp.zeros(50, dtype=wp.float32, device="cpu"))


def test_a_row_and_a_stack_of_just_that_row_are_told_apart() -> None:
    """They share their address and their size."""
    space = VectorSpace(np.ones(5))
    stack = space.stack(2)
    row, alone = stack[1], stack[1:]
    row.fill_(2.0)
    assert space.dot(row, row) == 20.0
    assert space.projections((alone, 1, row)).tolist() == [20.0]
    space.combine(row, alone, [1.0], row)
    assert row.numpy().tolist() == [4.0] * 5


@pytest.mark.parametrize("real", [wp.float64, wp.float32])
def test_sums_of_chunks_have_the_same_bits_wherever_their_nodes_stand(real: type) -> None:
    """Shifted by one place or three; a chunk at the end of the memory is among them."""
    found = [chunk_sums(real, shift) for shift in (0, 1, 3)]
    expected = [values[:6] @ values[6] for values in np.split(chunk_values(), [100, 104, 113], 1)]
    assert found[0] == pytest.approx(np.array(expected), rel=1e-6, abs=1e-5)
    assert found[0].tobytes() == found[1].tobytes() == found[2].tobytes()


def chunk_values() -> np.ndarray:
    return np.random.default_rng(5).standard_normal((7, 150))


def chunk_sums(real: type, shift: int) -> np.ndarray:
    """Products of six rows with a seventh by chunks that begin so far from the front; (4, 6)."""
    bounds = [0, 100, 104, 113, 150]
    values = np.pad(chunk_values(), ((0, 0), (shift, 0)), constant_values=np.nan)
    rows, weights, spans, found = (
        wp.array(array, dtype=kind, device="cpu")
        for array, kind in (
            (values, real),
            (np.ones(values.shape[1]), wp.float64),
            (shift + np.array([list(pairwise(bounds))]), wp.int32),
            (np.zeros(24), wp.float64),
        )
    )
    call = wp.array([found.ptr, 6, 1, rows.ptr, rows[6].ptr, 6], dtype=wp.uint64, device="cpu")
    inputs = [call, weights, spans, values.shape[1]]
    wp.launch(specialise(weighted_products, real), 1, inputs, device="cpu")
    return found.numpy().reshape(4, 6)


@pytest.mark.parametrize("total", [1, 2, 7, 54, 338])
def test_sums_along_a_tree_are_the_same_however_its_leaves_are_dealt_out(total: int) -> None:
    x = np.random.default_rng(total).standard_normal((total, 3))
    sums = [tree_sum(x, ranks) for ranks in (1, 2, 3, 5, total)]
    assert sums[0] == pytest.approx(x.sum(axis=0))
    assert all(np.array_equal(each, sums[0]) for each in sums)


def tree_sum(x: np.ndarray, ranks: int) -> np.ndarray:
    """Of rows (n, 3) dealt out to so many, each of which sums up the branches that it has."""
    bounds = np.arange(ranks + 1) * len(x) // ranks
    nodes, sums = [], []
    for first, behind in pairwise(bounds):
        leaves = np.stack([np.arange(first, behind), np.ones(behind - first)], axis=-1)
        nodes.append(branches(first, behind))
        sums.append(summed(leaves, x[first:behind], whole=False)[: len(nodes[-1])])
    assert sum(map(len, nodes)) <= 2 * ranks * max(1, len(x).bit_length())
    return summed(np.concatenate(nodes), np.concatenate(sums), whole=True)[0]


def summed(nodes: np.ndarray, x: np.ndarray, whole: bool) -> np.ndarray:
    room = wp.array(x, dtype=wp.float64, device="cpu")
    inputs = [wp.array(nodes, dtype=wp.int32, device="cpu"), int(whole), room]
    wp.launch(specialise(tree, wp.float64), 1, inputs, device="cpu")
    return room.numpy()


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_weights_must_be_positive(bad: float) -> None:
    with pytest.raises(ConfigError, match="positive"):
        VectorSpace([1.0, bad])
