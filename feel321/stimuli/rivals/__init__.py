"""Rival metrics: what else the literature compares vibrations by, so that the match metrics are not tried alone."""
