"""Compiled evolution of populations."""
