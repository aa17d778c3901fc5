"""Many runs judged together: sweeps, verification, stress trials, and their pages."""
