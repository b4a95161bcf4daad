"""A run: how it is put together, repeated, and read again from its log."""
