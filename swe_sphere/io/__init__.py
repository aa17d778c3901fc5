"""What comes out of a run: files, checkpoints, error norms, comparisons."""
