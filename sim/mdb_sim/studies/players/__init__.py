"""Who learns or plays in the place of the brain, on the same machines: what it is compared with."""
