"""Pictures of runs: fields on maps of the globe, with what they conserve underneath."""
