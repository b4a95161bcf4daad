"""Bodies that keep the contract in `mdb_sim.body`."""
