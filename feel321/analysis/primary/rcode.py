"""The primary model as code for R: the formula of lme4, and the penalty that lme4 does not have."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping

NAMED = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
RESERVED = frozenset({
    "if", "else", "repeat", "while", "function", "for", "next", "break", "in", "TRUE", "FALSE", "NULL", "Inf", "NaN",
    "NA",
})  # fmt: skip
"""Words that R reads as its own: as a column's name they need quoting."""

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


def make_r_name(name: str, taken: Collection[str] = (), *, ends: Collection[str] = ("",)) -> str:
    """Make a name that R, JASP and a formula take as it stands: ASCII letters, digits and underscores.

    It is none of those taken with any of the ends; upper and lower case are not told apart, as in names of files.
    """
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    plain = plain if NAMED.fullmatch(plain) else f"x{plain}"
    plain = f"{plain}_" if plain in RESERVED else plain
    used = {one.casefold() for one in taken}
    names = [plain, *(f"{plain}_{number}" for number in range(2, len(used) + 3))]
    return next(one for one in names if not any(f"{one}{end}".casefold() in used for end in ends))


def write_r_string(text: str) -> str:
    """Quote text for R, in ASCII."""
    quoted = text.replace("\\", "\\\\").replace('"', '\\"')
    letters = (c if c.isascii() and c.isprintable() else f"\\U{ord(c):08x}" for c in quoted)
    return f'"{"".join(letters)}"'.replace("\\U0000", "\\u")


def rename_terms(formula: str, names: Mapping[str, str]) -> str:
    """Rename the columns of a formula; a name in backquotes loses them."""
    return re.sub(
        r"`([^`]+)`|\b([^\W\d]\w*)\b",
        lambda match: names.get(match[1] or match[2], match[0]),
        formula,
    )


def write_fit(formula: str, data: str, *, penalty: Iterable[str] = ()) -> str:
    """Write the line that fits a model; `PENALISED` must stand before it where a spread is penalised."""
    if groups := ", ".join(map(write_r_string, penalty)):
        return f"lmer_penalised({formula}, {data}, {groups})"
    # lme4's defaults stop at 1e-4 or so of a standard error; these limits take a moment longer.
    control = 'lmerControl("bobyqa", optCtrl = list(rhoend = 1e-8, maxfun = 1e5))'
    return f"lmer({formula}, data = {data}, REML = TRUE, control = {control})"
