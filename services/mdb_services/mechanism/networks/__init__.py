"""Networks, what goes into them and comes out, and their random numbers."""
