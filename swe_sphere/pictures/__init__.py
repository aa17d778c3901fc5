"""Pictures of runs: fields on maps of the globe, with curves of conserved quantities below."""
