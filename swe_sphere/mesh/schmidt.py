"""Where the cube lies on the sphere: rotation, then Schmidt stretching about its centre.

The Schmidt transformation (Schmidt 1977; Courtier & Geleyn 1988, doi:10.1002/qj.49711448303)
is the conformal map of the sphere that shortens lengths s times at a centre c and lengthens
them s times at its antipode.  With D = (s^2-1)/(s^2+1) and mu = n.c it reads
n' = [(D + mu) c + sqrt(1 - D^2) (n - mu c)] / (1 + D mu); here numerator and denominator
are multiplied by s^2 + 1 and 1 +- mu is taken as |n +- c|^2 / 2, which keeps all digits
at the antipode.
"""

from dataclasses import dataclass

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.sphere import frame, position


def schmidt(n: Array, centre: Array, stretch: float) -> Array:
    """Unit vectors n (..., 3) moved towards the unit vector centre (3,); 1/stretch undoes it."""
    plus, minus = _sides(n, centre, stretch)
    across = n - (n @ centre)[..., None] * centre
    moved: Array = (plus - minus)[..., None] * centre + 2.0 * stretch * across
    moved /= np.sqrt(np.sum(moved**2, axis=-1, keepdims=True))
    return moved


def schmidt_tangent(n: Array, moved: Array, dn: Array, centre: Array, stretch: float) -> Array:
    """Derivative of `schmidt` at n (..., 3), moved = schmidt(n), along the tangents dn (..., 3)."""
    plus, minus = _sides(n, centre, stretch)
    dmu = (dn @ centre)[..., None]
    change: Array = (stretch**2 + 1.0) * dmu * centre + 2.0 * stretch * (dn - dmu * centre)
    change -= (stretch**2 - 1.0) * dmu * moved
    return change / (plus + minus)[..., None]


def _sides(n: Array, centre: Array, stretch: float) -> tuple[Array, Array]:
    """s^2 (1 + mu) and 1 - mu, both free of cancellation; their sum is (s^2+1)(1 + D mu)."""
    plus = 0.5 * stretch**2 * np.sum((n + centre) ** 2, axis=-1)
    minus = 0.5 * np.sum((n - centre) ** 2, axis=-1)
    return plus, minus


@dataclass(frozen=True)
class Placement:
    """The map from the plain cubed sphere to the sphere of the mesh, and its inverse.

    The centre (+x) of face 0 goes to `centre` = (lon, lat) [degrees], the cube is turned by
    `spin` [degrees] anticlockwise about that point, then refined there by the factor `stretch`.
    """

    centre: tuple[float, float] = (0.0, 0.0)
    spin: float = 0.0
    stretch: float = 1.0

    @property
    def turned(self) -> bool:
        """False where the rotation is the identity: it is then left out, to keep every bit."""
        return self.centre != (0.0, 0.0) or self.spin != 0.0

    @property
    def point(self) -> Array:
        """Unit vector (3,) of the centre."""
        return position(*np.radians(self.centre))

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3): its columns are the images of x, y and z."""
        east, north = frame(*np.radians(self.centre))
        spin = np.radians(self.spin)
        cos, sin = np.cos(spin), np.sin(spin)
        return np.stack([self.point, cos * east + sin * north, cos * north - sin * east], axis=1)

    def place(self, n: Array) -> Array:
        """Unit vectors (..., 3) on the sphere of points n (..., 3) of the plain cubed sphere."""
        n = n @ self.rotation.T if self.turned else n
        return schmidt(n, self.point, self.stretch) if self.stretch != 1.0 else n

    def place_tangent(self, n: Array, dn: Array) -> Array:
        """Derivative (..., 3) of `place` at n (..., 3) along the tangent vectors dn (..., 3)."""
        if self.turned:
            n, dn = n @ self.rotation.T, dn @ self.rotation.T
        if self.stretch == 1.0:
            return dn
        moved = schmidt(n, self.point, self.stretch)
        return schmidt_tangent(n, moved, dn, self.point, self.stretch)

    def lift(self, n: Array) -> Array:
        """The inverse of `place`, (..., 3) to (..., 3)."""
        n = schmidt(n, self.point, 1.0 / self.stretch) if self.stretch != 1.0 else n
        return n @ self.rotation if self.turned else n
