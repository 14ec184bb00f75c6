"""Figures: one module per kind, each a function from results to a matplotlib `Figure`.

Conventions: 14 cm wide, text of 8 points; every figure states its finding and names its unit, its interval and n.
Colours belong to reducers, are safe for the colour-blind, and markers differ with them. Nothing is computed here that
a result does not hold, but for what an eye needs: a smooth outline, a band, a median.
"""
