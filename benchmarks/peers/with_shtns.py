"""Vorticity, divergence and geopotential on the spherical harmonics of SHTns."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np
import serve
import shtns

ROBERT, WILLIAMS = 0.02, 0.53
"""Strength of the filter of leapfrog steps, and its share at the middle time (Williams 2009)."""
SMALL = 50
"""Truncation below which transforms are faster with fields contiguous in latitude."""


class Model:
    """Spectral model; a state is absolute vorticity, divergence and geopotential, (3, modes)."""

    def __init__(self, case: serve.Case) -> None:
        self.case, self.dt, sh = case, case.dt, shtns.sht(case.truncation)
        self.across = case.truncation < SMALL
        layout = shtns.SHT_THETA_CONTIGUOUS if self.across else shtns.SHT_PHI_CONTIGUOUS
        flags = shtns.sht_quick_init | layout | shtns.SHT_SOUTH_POLE_FIRST
        sh.set_grid(case.lat.size, case.lon.size, flags)
        self.sh, square = sh, sh.l * (sh.l + 1.0)
        self.curl, self.laplacian = square / case.radius, -square / case.radius**2
        self.to_wind = np.divide(case.radius, square, where=square > 0, out=np.zeros(sh.nlm))
        spheroidal, toroidal = sh.analys(self._laid(-case.v), self._laid(case.u))
        turn = 2.0 * case.rotation * np.sin(case.lat)
        self.planetary = self._modes(turn[:, None] + 0.0 * case.u)
        self.bottom = self._modes(case.gravity * case.b)
        depth = self._modes(case.gravity * case.h)
        self.mean = depth[0].real * sh.synth(np.eye(1, sh.nlm, dtype=complex)[0])[0, 0]
        vorticity = self.curl * toroidal + self.planetary
        self.initial = np.array([vorticity, -self.curl * spheroidal, depth])
        self.points = np.empty((6, *self._laid(case.h).shape))
        self.modes = np.empty((2, sh.nlm), complex)

    def _modes(self, field: np.ndarray) -> np.ndarray:
        return self.sh.analys(self._laid(field))

    def _laid(self, field: np.ndarray) -> np.ndarray:
        """Return a field in the layout of the transforms, or again as (M, K)."""
        return np.ascontiguousarray(field.T if self.across else field)

    def start(self, steps: int) -> np.ndarray:
        """Return a copy of the initial state."""
        return self.initial.copy()

    def run(self, state: np.ndarray, steps: int) -> np.ndarray:
        """Take classical Runge-Kutta steps, or semi-implicit leapfrog steps."""
        return {"rk4": self._rk4, "semi-implicit": self._leapfrog}[self.case.stepper](state, steps)

    def surface(self, state: np.ndarray) -> np.ndarray:
        """Return the free surface [m]."""
        return self._laid(self.sh.synth(state[2] + self.bottom)) / self.case.gravity

    def tendency(self, state: np.ndarray, rate: np.ndarray) -> None:
        """Write the rates of a state to `rate`: three transforms of scalars, three of vectors."""
        sh, (south, east, vorticity, depth, a, b), (s, t) = self.sh, self.points, self.modes
        np.subtract(state[0], self.planetary, out=t)
        t *= self.to_wind
        np.multiply(state[1], -self.to_wind, out=s)
        sh.SHsphtor_to_spat(s, t, south, east)
        sh.SH_to_spat(state[0], vorticity)
        sh.SH_to_spat(state[2], depth)
        np.multiply(south, vorticity, out=a)
        np.multiply(east, vorticity, out=b)
        sh.spat_to_SHsphtor(a, b, s, t)
        np.multiply(self.curl, s, out=rate[0])
        np.multiply(self.curl, t, out=rate[1])
        np.multiply(south, south, out=a)
        np.multiply(east, east, out=b)
        a += b
        a *= 0.5
        sh.spat_to_SH(a, s)
        s += self.bottom
        s += state[2]
        s *= self.laplacian
        rate[1] -= s
        south *= depth
        east *= depth
        sh.spat_to_SHsphtor(south, east, s, t)
        np.multiply(self.curl, s, out=rate[2])

    def _rk4(self, state: np.ndarray, steps: int) -> np.ndarray:
        stage, rate, total = (np.empty_like(state) for _ in range(3))
        for _ in range(steps):
            self.tendency(state, rate)
            total[:] = rate
            for reach, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
                np.multiply(rate, reach * self.dt, out=stage)
                stage += state
                self.tendency(stage, rate)
                np.multiply(rate, weight, out=stage)
                total += stage
            total *= self.dt / 6.0
            state += total
        return state

    def _leapfrog(self, now: np.ndarray, steps: int) -> np.ndarray:
        """Take leapfrog steps, trapezoidal for waves; the first step is half as long."""
        old, rate = now.copy(), np.empty_like(now)
        for n in range(steps):
            reach = self.dt * (1.0 if n else 0.5)
            self.tendency(now, rate)
            new = old + 2.0 * reach * rate
            bend = old - 2.0 * now
            new[1] -= reach * self.laplacian * bend[2]
            new[2] -= reach * self.mean * bend[1]
            new[1] -= reach * self.laplacian * new[2]
            new[1] /= 1.0 - reach**2 * self.mean * self.laplacian
            new[2] -= reach * self.mean * new[1]
            if n:
                push = 0.5 * ROBERT * (bend + new)
                now += WILLIAMS * push
                new += (WILLIAMS - 1.0) * push
            old, now = now, new
        return now


if __name__ == "__main__":
    serve.answer(Model, version("shtns"))
