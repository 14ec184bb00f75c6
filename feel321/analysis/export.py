"""Data for other programs: judgements as the primary models use them, wide tables, and the models as code for R.

Every file is CSV that R, JASP, jamovi and pandas read without options: UTF-8, comma, a header of plain names (letters,
digits, underscore), TRUE and FALSE, NA where a value is missing.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from feel321.analysis.primary import rcode
from feel321.analysis.primary.model import Slopes, fit_slopes
from feel321.analysis.primary.plan import ITEM, LEVEL, RATING, SCENE, WHO, make_cells
from feel321.analysis.report import section as parts
from feel321.analysis.report.folder import write_flags
from feel321.analysis.resampling import Choices
from feel321.analysis.table.dictionary import DICTIONARY, make_dictionary
from feel321.analysis.table.items import ROLE, STIMULUS, Part, Table, recast_pairs
from feel321.analysis.table.schema import APART
from feel321.doors import as_path, as_seed, describe
from feel321.files import make_folder, write_text

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame

    from feel321.analysis.table.metrics import Step
    from feel321.types import PathLike, Rng

JUDGEMENTS, STIMULI, SLOPES, SLOPES_R, SCRIPT, README = (
    "judgements.csv", "stimuli.csv", "slopes.csv", "slopes_r.csv", "model.R", "README.txt",
)  # fmt: skip
LABELS = (WHO, SCENE, "source", "reducer", "level", "stimulus", "scale", "repetition")
FURTHER = ("response_time_s", "simulated")
RESERVED = (*LABELS, RATING, *FURTHER, ITEM, STIMULUS, ROLE, "repeat", "column")
"""What no metric is called: columns of these files, and those that model.R makes."""

PARTS = ("", "_w", "_b", "_step")
"""Ends of the columns of every metric."""

SLOPE = (
    "scale",
    "level",
    "metric",
    "term",
    "step",
    "estimate",
    "se",
    "low",
    "high",
    "df",
    "t",
    "p",
    "estimable",
)
MISSING = "NA"
FIRST = "Ratings for other programs, written by feel321 export --r."
"""Begins the README of every export, by which an earlier one is known."""


@dataclass(frozen=True, slots=True, eq=False)
class ExportedModel:
    """The primary model of one scale and level: the judgements it was fitted to, and its slopes; or why there is none.

    rows: a row per judgement, columns by their exported names.
    """

    part: Part
    rows: DataFrame
    found: Slopes | None = None
    reason: str = ""


def export_r(table: Table, folder: PathLike, *, rng: Rng = 0) -> Path:
    """Write the data of the primary models, and code for R that fits them with lme4.

    Parameters
    ----------
    table : Table
        Ratings with their metrics, as `read_table` returns them.
    folder : path
        Where the files go: a new or empty folder, or one of an earlier export, which is replaced.
    rng : int or Generator
        Seed of the report; it decides which ratings are kept where there are too many for one fit.

    Returns
    -------
    Path
        The folder: ``judgements.csv`` (one row per judgement), ``stimuli.csv``, ``wide_SCALE.csv`` (participants x
        stimuli), ``slopes.csv`` (what feel321 estimates), ``model.R``, ``README.txt``.

    Raises
    ------
    ValueError
        If a name is ``NA``, which R reads as a missing value.
    FileExistsError
        If the folder holds anything but an earlier export.

    Examples
    --------
    >>> from feel321 import analysis
    >>> table = analysis.read_table("my-study")  # doctest: +SKIP
    >>> analysis.export_r(table, "for-r")  # doctest: +SKIP
    """
    if not isinstance(table, Table):
        raise TypeError(f"table must be a Table, as read_table returns it, got {describe(table)}")
    place = as_path(folder, "folder")
    _refuse_others(place)
    names = name_metrics(table.metrics)
    steps = parts.find_table_steps(table)
    models = list(_fit_models(table, Choices(seed=as_seed(rng)), names=names, steps=steps))
    stimuli = _list_stimuli(table, names)
    wide = _widen(table, stimuli)
    files = _name_files(wide)
    frames: dict[str, DataFrame] = {
        JUDGEMENTS: _stack((model.rows for model in models), (*LABELS, RATING)),
        STIMULI: stimuli,
        SLOPES: _stack((_list_slopes(model, names, steps) for model in models), SLOPE),
        **{files[scale]: frame for scale, frame in wide.items()},
    }
    for name, frame in frames.items():
        _refuse_missing_names(name, frame)
    frames[DICTIONARY] = make_dictionary(
        frames, {names[key]: table.info[key] for key in names if key in table.info}
    )
    _remove_earlier(place)
    make_folder(place)
    write_text(
        place / README, _write_readme(models, files)
    )  # first: the folder is ours from here on
    for name, frame in frames.items():
        write_csv(place / name, frame)
    write_text(place / SCRIPT, write_script(models, names))
    return place


def _refuse_others(place: Path) -> None:
    """Refuse a folder that holds anything but an earlier export."""
    if not place.exists():
        return
    if not place.is_dir():
        raise FileExistsError(f"{place}: is a file; give a new or empty folder")
    if (place / "study.toml").exists():
        raise FileExistsError(f"{place}: is a study; give a new folder, such as {place / 'for-r'}")
    readme = place / README
    ours = readme.is_file() and readme.read_bytes().startswith(FIRST.encode())
    if not ours and any(place.iterdir()):
        raise FileExistsError(
            f"{place}: holds files that are not of an earlier export; give a new or empty folder"
        )


def _remove_earlier(place: Path) -> None:
    """Remove the files of an earlier export that need not be written again: other scales, and what R found."""
    for path in (*place.glob("wide_*.csv"), place / SLOPES_R):
        path.unlink(missing_ok=True)


def write_csv(path: Path, frame: DataFrame) -> None:
    """Write a table as R reads it without options."""
    make_folder(path.parent)
    text = write_flags(frame).to_csv(
        index=False, na_rep=MISSING, float_format="%.12g", lineterminator="\n"
    )
    write_text(path, text)


def name_metrics(metrics: Iterable[str]) -> dict[str, str]:
    """Name the columns of metrics as R takes them, so that none is called as another or as a part of another."""
    names: dict[str, str] = {}
    for metric in metrics:
        taken = {*RESERVED, *(f"{own}{end}" for own in names.values() for end in PARTS)}
        names[metric] = rcode.make_r_name(metric, taken, ends=PARTS)
    return names


def _refuse_missing_names(file: str, frame: DataFrame) -> None:
    for name in frame.select_dtypes(exclude=["number", "bool"]):
        if (frame[name] == MISSING).any():
            raise ValueError(
                f"{file}: {name} must not be '{MISSING}', which R reads as a missing value; give it another name"
            )


def _fit_models(
    table: Table, choices: Choices, *, names: Mapping[str, str], steps: Mapping[str, Step]
) -> Iterator[ExportedModel]:
    """Fit the primary model of every scale and level as the report does, and put its columns beside the judgements."""
    for part in parts.thin_parts(table, choices):
        raw = {name: name for name in (*LABELS, RATING, *FURTHER)}
        raw |= {"stimulus": STIMULUS, "repetition": "repeat"}
        raw |= {name: metric for metric, name in names.items()}
        kept = [name for name in raw if raw[name] in part.rows]
        rows = part.rows[[raw[name] for name in kept]].set_axis(kept, axis=1)
        try:
            cells = make_cells(part.rows, table.metrics)
            found = fit_slopes(cells)
        except ValueError as error:
            yield ExportedModel(part, rows, reason=str(error))
            continue
        items = cells.table.drop_duplicates(ITEM).set_index(ITEM)
        for metric, name in names.items():
            within, between = (
                rows["stimulus"].map(items[f"{metric}{end}"]) for end in ("_w", "_b")
            )
            values = (within, between, within / steps[metric].size)
            rows = rows.assign(
                **dict(zip((f"{name}{end}" for end in PARTS[1:]), values, strict=True))
            )
        if LEVEL in items:
            rows = rows.assign(**{LEVEL: rows["stimulus"].map(items[LEVEL])})
        yield ExportedModel(part, rows, found)


def _list_slopes(
    model: ExportedModel, names: Mapping[str, str], steps: Mapping[str, Step]
) -> DataFrame:
    """List what feel321 estimates, in points per step of each metric."""
    import pandas as pd

    if model.found is None:
        return pd.DataFrame()
    rows = []
    for metric, row in model.found.table.iterrows():
        size = steps[str(metric)].size
        scaled = {name: row[name] * size for name in ("estimate", "se", "low", "high")}
        own = {"metric": names[str(metric)], "term": f"{names[str(metric)]}_step", "step": size}
        rows.append({
            "scale": model.part.scale, "level": model.part.level, **own, **scaled,
            **{name: row[name] for name in ("df", "t", "p")}, "estimable": bool(row["estimable"]),
        })  # fmt: skip
    return pd.DataFrame(rows, columns=list(SLOPE))


def _list_stimuli(table: Table, names: Mapping[str, str]) -> DataFrame:
    """List the rated stimuli with their metrics, and what each is called as a column of the wide tables."""
    keys = [STIMULUS, SCENE, "source", "reducer", "level", ROLE]
    rated = table.rows[[*(name for name in keys if name in table.rows), *table.metrics]]
    found = rated.rename(columns=names).drop_duplicates(STIMULUS)
    found = found.sort_values(STIMULUS, ignore_index=True)
    columns: dict[str, str] = {}
    for name in map(str, found[STIMULUS]):
        columns[name] = rcode.make_r_name(name, {WHO, *columns.values()})
    found.insert(1, "column", found[STIMULUS].map(columns))
    return found.rename(columns={STIMULUS: "stimulus"})


def _widen(table: Table, stimuli: DataFrame) -> dict[str, DataFrame]:
    """Tabulate participants x stimuli for every scale that rates one stimulus; means over repeats."""
    rows = recast_pairs(table.rows)
    columns = stimuli.set_index("stimulus")["column"]
    rows = rows[~rows["scale"].isin(APART)].assign(column=rows[STIMULUS].map(columns))
    return {
        str(scale): part.pivot_table(
            index=WHO, columns="column", values=RATING, aggfunc="mean", observed=True
        ).reset_index()
        for scale, part in rows.groupby("scale", observed=True)
    }


def _name_files(scales: Iterable[str]) -> dict[str, str]:
    """Name the file of every scale's wide table, each another also where case is not told apart."""
    names: dict[str, str] = {}
    for scale in scales:
        names[scale] = rcode.make_r_name(scale, names.values())
    return {scale: f"wide_{name}.csv" for scale, name in names.items()}


def _stack(frames: Iterable[DataFrame], columns: Iterable[str]) -> DataFrame:
    """Stack tables; without any, an empty one."""
    import pandas as pd

    found = [frame for frame in frames if len(frame)]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=list(columns))


# The code.

HEAD = """\
# Primary models of feel321 in R: ratings on match metrics, per scale and level.
# Run in this folder: Rscript model.R. It needs lme4; lmerTest, where it is installed, adds df and p.
suppressPackageStartupMessages(library(lme4))
has_tests <- requireNamespace("lmerTest", quietly = TRUE)

# One row per judgement of a test stimulus. Names stay text: a participant 007 is no number.
text <- c("participant", "recording", "source", "reducer", "level", "stimulus", "scale")
header <- names(read.csv("judgements.csv", nrows = 1))
kinds <- setNames(rep("character", sum(header %in% text)), header[header %in% text])
judgements <- read.csv("judgements.csv", colClasses = kinds, encoding = "UTF-8")
judgements$item <- judgements$stimulus
expected <- read.csv("slopes.csv", colClasses = c(scale = "character", level = "character"), encoding = "UTF-8")

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

NOTES = """\
# Columns: METRIC as in the manifest; METRIC_b its mean over the recording's stimuli (differences between recordings);
# METRIC_w the metric less that mean (differences within recordings); METRIC_step = METRIC_w in steps (see slopes.csv,
# such as 0.1 of a match), so that its slope is in points of rating per step; level_db the stimulus's level in dB less
# the mean of its recording's.
"""


def write_script(models: Sequence[ExportedModel], names: Mapping[str, str]) -> str:
    """Write ``model.R``."""
    text = [HEAD, NOTES]
    if any(model.found and model.found.terms.penalty for model in models):
        text.append(rcode.PENALISED)
    text += [_write_model(model, names) for model in models]
    return "\n".join([
        *text,
        f'if (length(found)) write.csv(do.call(rbind, found), "{SLOPES_R}", row.names = FALSE)',
        "",
    ]).replace(NOTES, f"{NOTES}found <- list()\n", 1)


def _write_model(model: ExportedModel, names: Mapping[str, str]) -> str:
    place = f"{model.part.scale}, {model.part.level}".encode("ascii", "backslashreplace").decode()
    if model.found is None:
        return f"cat({rcode.write_r_string(f'{place}: no model. {model.reason}')}, fill = TRUE)\n"
    scale, level = map(rcode.write_r_string, model.part.place)
    terms, cells = model.found.terms, model.found.cells
    columns = {f"{metric}_w": f"{own}_step" for metric, own in names.items()}
    columns |= {f"{metric}_b": f"{own}_b" for metric, own in names.items()}
    formula = rcode.rename_terms(terms.formula, columns)
    penalised = ", penalised = TRUE" if terms.penalty else ""
    lines = [
        f"# {place}",
        f"part <- subset(judgements, scale == {scale} & level == {level})",
        *(["part <- average_repeats(part)"] if cells.averaged else []),
        *(f"# Reduced: {reason}" for reason in terms.reductions),
        *_explain(terms.random),
        f"# feel321 believes at most {terms.most_df:g} degrees of freedom.",
        f"fit <- {rcode.write_fit(formula, 'part', penalty=terms.penalty)}",
        f"found[[length(found) + 1]] <- report(fit, {scale}, {level}{penalised})",
        "",
    ]
    return "\n".join(lines)


EXPLAINED = {
    WHO: "participants differ in their mean and in their slopes (|| : without correlations)",
    SCENE: "recordings differ in their mean, and in their slopes where these stand before the bar",
    ITEM: "stimuli differ for reasons not captured by the metrics",
    f"{WHO}:{SCENE}": "each participant has an own mean for each recording",
    f"{WHO}:{ITEM}": "a participant's repeats of one stimulus share their mean",
    "source": "recordings of one source share their mean and their slopes",
    "source:reducer": "stimuli of one source that were reduced alike share their mean",
    "reducer": "reducers differ for reasons not captured by the metrics",
    f"{WHO}:reducer": "each participant has an own opinion of each reducer",
}


def _explain(random: Iterable[str]) -> Iterator[str]:
    """Say in a comment what each random term stands for."""
    for term in random:
        group = re.sub(r".*\|\s*(.*?)\)", r"\1", term)
        yield f"#   (... | {group}): {EXPLAINED.get(group, group)}"


def _write_readme(models: Sequence[ExportedModel], files: Mapping[str, str]) -> str:
    without = [
        f"  {model.part.lead}: no model. {model.reason}" for model in models if not model.found
    ]
    thinned = [f"  {model.part.thinned}" for model in models if model.part.thinned]
    return "\n".join([
        FIRST,
        "",
        f"{JUDGEMENTS}  one row per judgement of a test stimulus, as the primary models use it",
        f"{STIMULI}     one row per rated stimulus: labels, metrics, and its column in the wide tables",
        "wide_*.csv      participants x stimuli, means over repeats; references and anchors included:",
        *(f"  {file}  scale {scale}" for scale, file in files.items()),
        f"{SLOPES}      slopes that feel321 estimates, in points of rating per step of the metric",
        f"{SCRIPT}         fits the same models with lme4, prints them beside slopes.csv and writes slopes_r.csv",
        "dictionary.csv  every column of these files: type, unit, allowed values, meaning",
        "",
        'R:     setwd() to this folder, then source("model.R"); or Rscript model.R',
        "JASP:  open judgements.csv (linear mixed models) or a wide table (repeated measures ANOVA)",
        "",
        "The files are UTF-8 with commas; flags are TRUE and FALSE, missing values NA.",
        *(["", "Without a model:", *without] if without else []),
        *(["", "Fewer ratings than there are:", *thinned] if thinned else []),
        "",
    ])
