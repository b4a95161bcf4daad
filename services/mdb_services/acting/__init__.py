"""The action optimizer."""
