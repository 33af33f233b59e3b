"""Many runs at once: compiled steps in lockstep, C in vector lanes, sampled loops."""
