"""Linear mixed models with crossed and nested random effects, in lme4's notation."""
