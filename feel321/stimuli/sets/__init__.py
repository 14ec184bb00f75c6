"""Stimulus sets: recipe, rendering, manifest, checks."""
