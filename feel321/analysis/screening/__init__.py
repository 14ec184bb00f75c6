"""Screening of raters: rules with limits, and lists of whom they flag.

judgements (the tidy table, prepared), rules (the one list), screen (`screen_raters`). Nothing here removes anybody: a
flag is a reason to look, and a deletion needs a documented error.
"""
