"""A report made from a dataset alone, as `analyze --bids` does: the numbers are those of the study's report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.analysis.bids import open_dataset
from feel321.analysis.report.front import About
from feel321.analysis.report.write import Results, write_report
from feel321.files import temporary_folder
from feel321.study.paper import make_paper
from feel321.study.settings.paper import PaperTable
from feel321.study.settings.schema import Settings

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.types import Progress


def analyze_dataset(folder: Path, out: Path, *, progress: Progress = False) -> Results:
    """Write the report of a dataset, with the choices that were exported with it."""
    with temporary_folder() as place:
        opened = open_dataset(folder, place)
        own, further = opened.choices, opened.further
        paper = own["paper"] and PaperTable.model_validate(own["paper"])
        return write_report(
            opened.ratings,
            opened.manifest,
            out,
            draws=own["analysis"]["draws"],
            margin=own["analysis"]["margin"],
            metrics=own["analysis"]["metrics"],
            further=further,
            info=opened.info,
            paper=make_paper(Settings.model_construct(paper=paper or None), further.mountings),
            about=About(own["name"], "", tuple(own["protocols"])),
            seed=own["seed"],
            progress=progress,
        )
