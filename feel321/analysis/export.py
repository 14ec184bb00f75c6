"""Data for R, JASP and jamovi: judgements as the primary models use them, their slopes, and the models as code for R.

Every table is CSV that these programs read without options: UTF-8, comma, a header of plain names (letters, digits,
underscore), TRUE and FALSE, NA where a value is missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321.analysis.primary import rcode
from feel321.analysis.primary.model import Slopes, fit_slopes
from feel321.analysis.primary.plan import ITEM, LEVEL, RATING, SCENE, WHO, make_cells
from feel321.analysis.report import section as parts
from feel321.analysis.report.folder import write_flags
from feel321.analysis.resampling import Choices
from feel321.analysis.table.dictionary import DICTIONARY, make_dictionary
from feel321.analysis.table.items import ROLE, STIMULUS, Part, Table
from feel321.doors import as_path, as_seed, describe
from feel321.files import make_folder, write_text

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame

    from feel321.analysis.table.metrics import Step
    from feel321.types import PathLike, Rng

JUDGEMENTS, SLOPES, SLOPES_R, SCRIPT = "judgements.csv", "slopes.csv", "slopes_r.csv", "model.R"
LABELS = (WHO, SCENE, "source", "reducer", "level", "stimulus", "scale", "repetition")
FURTHER = ("response_time_s", "simulated")
RESERVED = (*LABELS, RATING, *FURTHER, ITEM, STIMULUS, ROLE, "repeat", "column")
"""What no metric is called: columns of these files, and those that model.R makes."""

PARTS = ("", "_w", "_b", "_step")  # Ends of the columns of every metric
SLOPE = (
    "scale", "level", "metric", "term", "step", "estimate", "se", "low", "high", "df", "t", "p", "estimable",
)  # fmt: skip
MISSING = "NA"
FIRST = "# Primary models of feel321 in R: ratings on match metrics, per scale and level."
"""Begins the script of every export, by which an earlier one is known."""


@dataclass(frozen=True, slots=True, eq=False)
class ExportedModel:
    """The primary model of one scale and level: its judgements, and its slopes; or why there is none."""

    part: Part
    rows: DataFrame
    found: Slopes | None = None
    reason: str = ""


def export_r(table: Table, folder: PathLike, *, rng: Rng = 0) -> Path:
    """Write the data of the primary models to a folder, and code for R that fits them with lme4.

    ``judgements.csv``: one row per judgement; ``slopes.csv``: what feel321 estimates; ``model.R``; ``dictionary.csv``.
    folder: a new or empty one, or that of an earlier export, which is replaced. rng: seed of the report; it decides
    which ratings are kept where there are too many for one fit.
    """
    import pandas as pd

    if not isinstance(table, Table):
        raise TypeError(f"table must be a Table, as read_table returns it, got {describe(table)}")
    place = as_path(folder, "folder")
    script = place / SCRIPT
    is_ours = script.is_file() and script.read_bytes().startswith(FIRST.encode())
    if place.is_file() or (place.is_dir() and any(place.iterdir()) and not is_ours):
        why = "holds files that are not of an earlier export, or is one"
        raise FileExistsError(f"{place}: {why}; give a new or empty folder")
    names: dict[str, str] = {}
    for metric in table.metrics:
        taken = {*RESERVED, *(f"{own}{end}" for own in names.values() for end in PARTS)}
        names[metric] = rcode.make_r_name(metric, taken, ends=PARTS)
    steps = parts.find_table_steps(table)
    models = list(_fit_models(table, Choices(seed=as_seed(rng)), names=names, steps=steps))
    slopes = [row for model in models for row in _list_slopes(model, names, steps)]
    frames: dict[str, DataFrame] = {
        JUDGEMENTS: pd.concat([model.rows for model in models], ignore_index=True),
        SLOPES: pd.DataFrame(slopes, columns=list(SLOPE)),
    }
    for file, frame in frames.items():
        for name in frame.select_dtypes(exclude=["number", "bool"]):
            if (frame[name] == MISSING).any():
                why = "which R reads as a missing value; give it another name"
                raise ValueError(f"{file}: {name} must not be '{MISSING}', {why}")
    known = {names[key]: table.info[key] for key in names if key in table.info}
    frames[DICTIONARY] = make_dictionary(frames, known)
    make_folder(place)
    write_text(script, write_script(models, names))  # first: the folder is ours from here on
    (place / SLOPES_R).unlink(missing_ok=True)
    form: Any = {"na_rep": MISSING, "float_format": "%.12g", "lineterminator": "\n"}
    for name, frame in frames.items():
        write_text(place / name, write_flags(frame).to_csv(index=False, **form))
    return place


def _fit_models(
    table: Table, choices: Choices, *, names: Mapping[str, str], steps: Mapping[str, Step]
) -> Iterator[ExportedModel]:
    """Fit the primary model of every scale and level as the report does, and put its columns beside the judgements."""
    raw = {name: name for name in (*LABELS, RATING, *FURTHER)}
    raw |= {"stimulus": STIMULUS, "repetition": "repeat"}
    raw |= {name: metric for metric, name in names.items()}
    for part in parts.thin_parts(table, choices):
        kept = [name for name in raw if raw[name] in part.rows]
        rows = part.rows[[raw[name] for name in kept]].set_axis(kept, axis=1)
        try:
            found = fit_slopes(make_cells(part.rows, table.metrics))
        except ValueError as error:
            yield ExportedModel(part, rows, reason=str(error))
            continue
        items = found.cells.rated.set_index(ITEM).reindex(rows["stimulus"])
        for metric, name in names.items():
            within, between = (items[f"{metric}{end}"].to_numpy() for end in ("_w", "_b"))
            values = (within, between, within / steps[metric].size)
            ends = (f"{name}{end}" for end in PARTS[1:])
            rows = rows.assign(**dict(zip(ends, values, strict=True)))
        if LEVEL in items:
            rows = rows.assign(**{LEVEL: items[LEVEL].to_numpy()})
        yield ExportedModel(part, rows, found)


def _list_slopes(
    model: ExportedModel, names: Mapping[str, str], steps: Mapping[str, Step]
) -> Iterator[dict[str, object]]:
    """List what feel321 estimates, in points per step of each metric."""
    for metric, row in model.found.table.iterrows() if model.found else ():
        size, name = steps[str(metric)].size, names[str(metric)]
        yield {
            "scale": model.part.scale, "level": model.part.level, "metric": name, "term": f"{name}_step", "step": size,
            **{key: row[key] * size for key in ("estimate", "se", "low", "high")},
            **{key: row[key] for key in ("df", "t", "p")}, "estimable": bool(row["estimable"]),
        }  # fmt: skip


HEAD = """
# Run in this folder: Rscript model.R. It needs lme4; lmerTest, where it is installed, adds df and p.
# judgements.csv: one row per judgement of a test stimulus. METRIC as in the manifest; METRIC_b its mean over the
# recording's stimuli (differences between recordings); METRIC_w the metric less that mean (differences within
# recordings); METRIC_step = METRIC_w in steps (see slopes.csv, such as 0.1 of a match), so that its slope is in points
# of rating per step; level_db the stimulus's level in dB less the mean of its recording's.
# slopes.csv: what feel321 estimates; dictionary.csv: every column.
suppressPackageStartupMessages(library(lme4))
has_tests <- requireNamespace("lmerTest", quietly = TRUE)

# Names stay text: a participant 007 is no number.
text <- c("participant", "recording", "source", "reducer", "level", "stimulus", "scale")
header <- names(read.csv("judgements.csv", nrows = 1))
kinds <- setNames(rep("character", sum(header %in% text)), header[header %in% text])
judgements <- read.csv("judgements.csv", colClasses = kinds, encoding = "UTF-8")
judgements$item <- judgements$stimulus
expected <- read.csv("slopes.csv", colClasses = c(scale = "character", level = "character"), encoding = "UTF-8")
found <- list()

# Where every participant rated every stimulus equally often, means over repeats are sufficient for the slopes.
average_repeats <- function(rows) {
  rows$rating <- ave(rows$rating, rows$participant, rows$stimulus)
  rows[!duplicated(rows[c("participant", "stimulus")]), ]
}

# Print the model, and its slopes beside those of feel321 (slopes.csv).
report <- function(fit, scale, level, penalised = FALSE) {
  cat("\\n==", scale, level, "\\n")
  print(summary(if (has_tests && !penalised) lmerTest::as_lmerModLmerTest(fit) else fit), correlation = FALSE)
  own <- expected[expected$scale == scale & expected$level == level, ]
  se <- sqrt(diag(as.matrix(vcov(fit))))
  free <- nobs(fit) - length(fixef(fit))
  if (penalised) se <- se * sqrt(free / (free - 1))  # the penalty takes one degree of freedom of the residual
  print(data.frame(
    term = own$term, lme4 = fixef(fit)[own$term], feel321 = own$estimate,
    se_lme4 = se[own$term], se_feel321 = own$se, row.names = NULL
  ), digits = 6)
  data.frame(scale, level, term = own$term, estimate = fixef(fit)[own$term], se = se[own$term], row.names = NULL)
}
"""


def write_script(models: Sequence[ExportedModel], names: Mapping[str, str]) -> str:
    """Write ``model.R``."""
    text = [FIRST + HEAD]
    if any(model.found and model.found.terms.penalty for model in models):
        text.append(rcode.PENALISED)
    text += [_write_model(model, names) for model in models]
    end = f'if (length(found)) write.csv(do.call(rbind, found), "{SLOPES_R}", row.names = FALSE)\n'
    return "\n".join([*text, end])


def _write_model(model: ExportedModel, names: Mapping[str, str]) -> str:
    place = f"{model.part.scale}, {model.part.level}".encode("ascii", "backslashreplace").decode()
    if model.found is None:
        return f"cat({rcode.write_r_string(f'{place}: no model. {model.reason}')}, fill = TRUE)\n"
    scale, level = map(rcode.write_r_string, model.part.place)
    terms = model.found.terms
    columns = {f"{metric}_w": f"{own}_step" for metric, own in names.items()}
    columns |= {f"{metric}_b": f"{own}_b" for metric, own in names.items()}
    formula = rcode.rename_terms(terms.formula, columns)
    penalised = ", penalised = TRUE" if terms.penalty else ""
    averaged: Iterable[str] = ["part <- average_repeats(part)"] * model.found.cells.averaged
    return "\n".join([
        f"# {place}",
        f"part <- subset(judgements, scale == {scale} & level == {level})",
        *averaged,
        *(f"# Reduced: {reason}" for reason in terms.reductions),
        f"# feel321 believes at most {terms.most_df:g} degrees of freedom.",
        f"fit <- {rcode.write_fit(formula, 'part', penalty=terms.penalty)}",
        f"found[[length(found) + 1]] <- report(fit, {scale}, {level}{penalised})",
        "",
    ])
