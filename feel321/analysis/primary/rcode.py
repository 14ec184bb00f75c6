"""The primary model as code for R: the formula of lme4, and the penalty that lme4 does not have."""

from __future__ import annotations

from collections.abc import Iterable

PENALISED = """\
# Few reducers: their spread would often be estimated as 0 when it is only unknown. As feel321 does, -2 log(SD of the
# group) is added to the REML criterion (Chung et al. 2013, doi:10.1007/s11336-013-9328-2), which lme4 cannot.
lmer_penalised <- function(formula, data, group) {
  parts <- lFormula(formula, data = data, REML = TRUE)      # the model's matrices
  criterion <- do.call(mkLmerDevfun, parts)                 # REML criterion by relative spreads (theta)
  state <- environment(criterion)
  place <- which(names(parts$reTrms$cnms) == group)         # one theta per term: effects are uncorrelated
  objective <- function(theta) {
    value <- criterion(theta)
    value - log(state$resp$wrss() + state$pp$sqrL(1)) - 2 * log(theta[place])
  }
  lower <- parts$reTrms$lower
  lower[place] <- 1e-6
  best <- minqa::bobyqa(parts$reTrms$theta, objective, lower = lower, control = list(rhoend = 1e-8, maxfun = 1e5))
  value <- criterion(best$par)
  found <- list(par = best$par, fval = value, feval = best$feval, conv = 0)
  mkMerMod(state, found, parts$reTrms, parts$fr)
}
"""


def write_r_string(text: str) -> str:
    """Quote text for R, in ASCII."""
    quoted = text.replace("\\", "\\\\").replace('"', '\\"')
    letters = (c if c.isascii() and c.isprintable() else f"\\U{ord(c):08x}" for c in quoted)
    return f'"{"".join(letters)}"'.replace("\\U0000", "\\u")


def write_fit(formula: str, data: str, *, penalty: Iterable[str] = ()) -> str:
    """Write the line that fits a model; `PENALISED` must stand before it where a spread is penalised."""
    if groups := ", ".join(map(write_r_string, penalty)):
        return f"lmer_penalised({formula}, {data}, {groups})"
    # lme4's defaults stop at 1e-4 or so of a standard error; these limits take a moment longer.
    control = 'lmerControl("bobyqa", optCtrl = list(rhoend = 1e-8, maxfun = 1e5))'
    return f"lmer({formula}, data = {data}, REML = TRUE, control = {control})"
