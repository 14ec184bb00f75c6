"""Audit: check that a study still holds what was recorded."""
