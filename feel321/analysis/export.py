"""Data for R, JASP and jamovi: the judgements, and the primary model of every scale and level with code for lme4.

Tables are CSV that these programs read without options: UTF-8, comma, TRUE and FALSE, NA where a value is missing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.analysis.primary.model import PENALISED, Primary, fit_primary, write_fit
from feel321.analysis.primary.plan import ITEM, REDUCER, SCENE, SOURCE, WHO
from feel321.analysis.report.folder import write_flags
from feel321.analysis.report.section import make_slug, thin_parts
from feel321.analysis.resampling import Choices
from feel321.analysis.table.columns import DICTIONARY, make_dictionary
from feel321.analysis.table.items import Table
from feel321.doors import as_path, as_seed, describe
from feel321.files import make_folder, write_text

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.types import PathLike, Rng

JUDGEMENTS, SCRIPT, SLOPES = "judgements.csv", "model.R", "slopes.csv"
MISSING = "NA"
FIRST = "# Primary models of feel321 in R: run in this folder, Rscript model.R; it needs lme4 and lmerTest.\n"
"""Begins the script of every export, by which an earlier one is known."""


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
    lines = [
        "library(lmerTest)",
        'model <- read.csv("model.csv", check.names = FALSE)',
        *(f"model${name} <- factor(model${name})" for name in groups),
        *([PENALISED.rstrip()] if model.penalty else []),
        f"# feel321 believes at most {model.fit.uncertainty.most_df:g} degrees of freedom.",
        f"fit <- {write_fit(model.formula, 'model', penalty=model.penalty)}",
        "print(summary(fit))",
        "",
    ]
    make_folder(place)
    write_text(place / SCRIPT, "\n".join(lines))
    for name, frame in {"model.csv": model.model_frame, SLOPES: model.slopes.reset_index()}.items():
        write_text(place / name, write_flags(frame).to_csv(index=False, na_rep=MISSING))
