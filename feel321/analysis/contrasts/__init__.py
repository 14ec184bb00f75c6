"""Reducers against one another: means, differences that matter or do not, choices between two."""
