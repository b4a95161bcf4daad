"""Certificates, and who may say what."""
