"""Screening of raters: rules with limits, and lists of the raters that they flag.

Nothing here removes anybody: a flag is a reason to look, and a deletion needs a documented error.
"""
