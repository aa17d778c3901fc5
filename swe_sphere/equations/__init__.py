"""The equations: effects, scenes and the right-hand side."""
