"""Figures: one module per kind, each a function from results to a matplotlib `Figure`.

Conventions: one column wide (8.5 cm), text of 7 points or more; every figure names its unit, its interval and n;
colours are safe for the colour-blind, and markers differ with them. Nothing is computed here that a result does
not hold, but for what an eye needs: a smooth outline, a band, a median.
"""
