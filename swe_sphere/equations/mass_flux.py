"""What carries tracers that take long steps: the mass that has crossed each point."""

import warp as wp

from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.kernels.tracer_step import flux_kernel


class MassFlux:
    """Two blocks G (N,) [m2] in the place of tracers behind wind and depth, with dG/dt = h V.

    Without dissipation and sources dh/dt = -div(dG/dt), and every scheme that combines tendencies
    and states linearly keeps h + div G to round-off: what it has added to G between two times is
    the mass flux with which tracers have to be carried from one to the other.
    """

    names = ("flux_u", "flux_v")

    def __init__(self, discrete: DiscreteScene) -> None:
        self._launch, self._size = discrete.launch, discrete.device_mesh.size
        self.first = discrete.fluid_size
        """Where G begins in a state vector."""
        self.depth = self.first - self._size
        """Where the depth begins."""
        self._kernel = flux_kernel(discrete.device_mesh.real)
        self._launch.load(self._kernel)

    def tendency(self, x: wp.array, out: wp.array) -> None:
        """out_G = h V at the state x."""
        self.carry(x, x, out)

    transport = tendency

    def carry(self, wind: wp.array, x: wp.array, out: wp.array) -> None:
        """out_G = h V with the wind in front of `wind`."""
        size = self._size
        self._launch(self._kernel, size, wind, x, self.depth, size, self.first, out)

    def diffuse(self, x: wp.array, out: wp.array) -> None:
        """Dissipation is no flux: out_G = 0."""
        out[self.first :].zero_()
