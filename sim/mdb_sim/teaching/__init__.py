"""Scripted teachers: what they want, in which language, when, and how they are heard."""
