"""Linear mixed models with crossed and nested random effects, in lme4's notation.

design (formula to matrices), profile (the deviance), optimum (its derivative and minimum), model
(`fit_mixed`, `contrast`).
"""
