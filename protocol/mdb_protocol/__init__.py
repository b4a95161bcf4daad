"""Keys, messages, codec and bus: all that a remote client of the brain needs."""
