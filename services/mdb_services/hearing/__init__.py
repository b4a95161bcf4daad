"""The ear."""
