"""One run from its configuration to its summary: set-up, loop, diagnostics, files, restart."""
