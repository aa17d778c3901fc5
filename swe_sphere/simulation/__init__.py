"""A whole run: configuration, time plan, loop, health check, result."""
