"""Many runs: what a population of plants, starts and disturbances makes of one design."""
