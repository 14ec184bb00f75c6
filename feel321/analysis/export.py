"""Data for R, JASP and jamovi: the judgements, and the primary model of every scale and level with code for lme4.

Tables are CSV that these programs read without options: UTF-8, comma, TRUE and FALSE, NA where a value is missing.
"""

from pathlib import Path

from feel321.analysis.primary.model import Primary, fit_primary
from feel321.analysis.primary.plan import ITEM, REDUCER, SCENE, SOURCE, WHO
from feel321.analysis.report.folder import write_flags
from feel321.analysis.report.section import make_slug, thin_parts
from feel321.analysis.resampling import Choices
from feel321.analysis.table.columns import DICTIONARY, make_dictionary
from feel321.analysis.table.items import Table
from feel321.arguments import as_path, as_seed, describe
from feel321.files import make_folder, write_text
from feel321.types import PathLike, Rng

JUDGEMENTS, SCRIPT = "judgements.csv", "model.R"
MISSING = "NA"
# Begins the script of every export, by which an earlier one is known.
FIRST = "# Primary models of feel321 in R: run in this folder, Rscript model.R; it needs lme4 and lmerTest.\n"

PENALISED = """\
# Few reducers: their spread would often be estimated as 0 when it is only unknown. As feel321 does, -2 log(SD of the
# reducers) is added to the REML criterion (Chung et al. 2013, doi:10.1007/s11336-013-9328-2), which lme4 cannot.
lmer_penalised <- function(formula, data) {
  parts <- lFormula(formula, data = data, REML = TRUE)      # the model's matrices
  criterion <- do.call(mkLmerDevfun, parts)                 # REML criterion by relative spreads (theta)
  state <- environment(criterion)
  place <- which(names(parts$reTrms$cnms) == "reducer")     # one theta per term: effects are uncorrelated
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


def export_r(table: Table, folder: PathLike, *, rng: Rng = 0) -> Path:
    """Write the judgements to a folder, and, per scale and level, the primary model's data, slopes and code for lme4.

    ``judgements.csv``; ``SCALE_LEVEL/model.csv``, ``model.R`` and ``slopes.csv``, what feel321 estimates; ``model.R``
    runs them all. folder: a new or empty one, or that of an earlier export, which is replaced. rng: seed of the report;
    it decides which ratings are kept where there are too many for one fit.
    """
    if not isinstance(table, Table):
        raise TypeError(f"table must be a Table, as read_table returns it, got {describe(table)}")
    place = as_path(folder, "folder")
    script = place / SCRIPT
    is_ours = script.is_file() and script.read_bytes().startswith(FIRST.encode())
    if place.is_file() or (place.is_dir() and any(place.iterdir()) and not is_ours):
        why = "holds files that are not of an earlier export, or is one"
        raise FileExistsError(f"{place}: {why}; give a new or empty folder")
    for name in table.rows.select_dtypes(exclude=["number", "bool"]):
        if (table.rows[name] == MISSING).any():
            why = "which R reads as a missing value; give it another name"
            raise ValueError(f"{JUDGEMENTS}: {name} must not be '{MISSING}', {why}")
    make_folder(place)
    write_text(script, FIRST)  # first: the folder is ours from here on
    text = [FIRST]
    for part in thin_parts(table, Choices(seed=as_seed(rng))):
        own = make_slug(*part.place)
        try:
            model = fit_primary(part.rows, table.metrics, explain=False)
        except ValueError as error:
            text.append(f"# {part.lead}: no model. {error}")
            continue
        _write_model(model, place / own)
        text.append(f'source("{own}/{SCRIPT}", chdir = TRUE)')
    frames = {JUDGEMENTS: table.rows}
    frames[DICTIONARY] = make_dictionary(frames, table.info)
    for name, frame in frames.items():
        write_text(place / name, write_flags(frame).to_csv(index=False, na_rep=MISSING))
    write_text(script, "\n".join([*text, ""]))
    return place


def _write_model(model: Primary, place: Path) -> None:
    """Write the data of a primary model, its slopes, and R code that fits the same model with lme4 and lmerTest."""
    groups = [name for name in (WHO, SCENE, ITEM, REDUCER, SOURCE) if name in model.model_frame]
    # lme4's defaults stop at 1e-4 or so of a standard error; these limits take a moment longer.
    control = 'lmerControl("bobyqa", optCtrl = list(rhoend = 1e-8, maxfun = 1e5))'
    fit = f"lmer({model.formula}, data = model, REML = TRUE, control = {control})"
    lines = [
        "library(lmerTest)",
        'model <- read.csv("model.csv", check.names = FALSE)',
        *(f"model${name} <- factor(model${name})" for name in groups),
        *([PENALISED.rstrip()] if model.penalty else []),
        f"# feel321 believes at most {model.fit.uncertainty.most_df:g} degrees of freedom.",
        f"fit <- {f'lmer_penalised({model.formula}, model)' if model.penalty else fit}",
        "print(summary(fit))",
        "",
    ]
    make_folder(place)
    write_text(place / SCRIPT, "\n".join(lines))
    frames = {"model.csv": model.model_frame, "slopes.csv": model.slopes.reset_index()}
    for name, frame in frames.items():
        write_text(place / name, write_flags(frame).to_csv(index=False, na_rep=MISSING))
