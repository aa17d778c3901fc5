"""Output of a run: files, checkpoints, error norms, comparisons."""
