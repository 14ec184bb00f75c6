"""Audit: whether what a study holds is what was recorded."""
