"""Linear mixed models with crossed and nested random effects, in lme4's notation.

formula (text -> terms), design (terms -> matrices), layout (where each factor stands), profile (the deviance),
balanced (the same where everybody rated everything), slope (its derivative), solution (effects), optimum (its
minimum), inference (Satterthwaite), model (`fit_mixed` and `contrast`, from end to end).
"""
