"""Krylov and Newton-Krylov solvers on device vectors, and preconditioners."""
