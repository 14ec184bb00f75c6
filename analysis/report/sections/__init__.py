"""The sections of a report, one module each, all of one shape: `compute(table, choices) -> Section`.

section (the record), choices (what may be chosen), parts (ratings split by scale and level), thinning (parts that no
model can carry), listing (the one list); then, in the report's order: primary, association, levels, profile,
contrasts, discrimination, space, refined, raters, robustness, standard (P.1401 and its kin). A section that the ratings
do not allow is left out, and its notes say why.
"""
