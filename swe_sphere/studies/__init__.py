"""Many runs judged together: sweeps, verification, stability cases, and their pages."""
