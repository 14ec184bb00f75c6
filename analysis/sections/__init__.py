"""The sections of a report, one module each, all of one shape: `compute(table, choices) -> Section`.

section (the record), choices (what may be chosen), parts (ratings split by scale and level), listing (the one list);
then, in the report's order: primary, association, levels, reducers, raters, robustness, classic, standard (P.1401),
duels, discrimination, space. A section that the ratings do not allow is left out, and its notes say why.
"""
