"""What the files in a run folder are called that several rooms read or write."""

EXPERIMENT_FILE = "experiment.toml"
"""The resolved experiment, its seed in it."""
MEMORY_FILE = "memory.sqlite"
"""The memory store's database."""
BEGINNING_FILE = "memory.beginning.sqlite"
"""The same before the first pair, where a run begins with models of another one: what a replay begins with."""
