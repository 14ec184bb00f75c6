"""A dataset read back: the study's own numbers, here, in pandas and in R."""

from __future__ import annotations

import shutil
import subprocess
from typing import TYPE_CHECKING

import pandas as pd
import pytest

from feel321 import analysis
from feel321.analysis.bids import read_tsv
from feel321.study.analyze import analyze_study, read_study_table
from feel321.study.export.readback import analyze_dataset

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.study.folder import StudyFolder


def test_the_table_is_the_studys_own_number_by_number(
    studied: StudyFolder, export: Callable[..., Path]
) -> None:
    own, _ = read_study_table(studied)
    read = analysis.read_bids(export(simulated=True, keep_ids=True))
    assert read.metrics == own.metrics
    pd.testing.assert_frame_equal(
        read.rows.drop(columns="source"), own.rows.drop(columns="source"), check_exact=True
    )
    assert own.stimuli is not None
    pd.testing.assert_frame_equal(
        read.stimuli.drop(columns="source"), own.stimuli.drop(columns="source"), check_exact=True
    )
    assert read.rows["source"].nunique() == own.rows["source"].nunique()


def test_new_numbers_change_names_only(studied: StudyFolder, export: Callable[..., Path]) -> None:
    own, _ = read_study_table(studied)
    read = analysis.read_bids(export(simulated=True))
    assert len(set(read.rows["participant"])) == len(set(own.rows["participant"])) == 2
    known = ["stimulus_id", "scale", "repeat", "rating", *own.metrics]
    ratings = [
        sorted(map(tuple, rows[known].itertuples(index=False))) for rows in (read.rows, own.rows)
    ]
    assert ratings[0] == ratings[1]


@pytest.mark.soak
def test_the_report_of_a_dataset_has_the_studys_numbers(
    studied: StudyFolder, export: Callable[..., Path], tmp_path: Path
) -> None:
    dataset = export(simulated=True, keep_ids=True)
    own = analyze_study(studied, out=tmp_path / "own").to_frame()
    again = analyze_dataset(dataset, tmp_path / "again").to_frame()
    pd.testing.assert_frame_equal(again, own, check_exact=True)


def test_r_reads_the_same_numbers(dataset: Path) -> None:
    if not (program := shutil.which("Rscript")):
        pytest.skip("Rscript is not on this machine: nothing was tried in R")
    code = """
    files <- Sys.glob(file.path(commandArgs(TRUE), "sub-*", "beh", "*_beh.tsv"))
    rows <- do.call(rbind, lapply(files, read.delim, na.strings = "n/a"))
    flat <- do.call(rbind, lapply(Sys.glob(file.path(commandArgs(TRUE), "data", "task-*_data.csv")), read.csv))
    stopifnot(is.numeric(rows$rating), nrow(rows) == nrow(flat), sum(rows$rating) == sum(flat$rating))
    cat(nrow(rows), sprintf("%.17g", rows$rating))
    """
    command = [program, "--vanilla", "-e", code, str(dataset)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    count, *ratings = done.stdout.split()
    files = sorted(dataset.glob("sub-*/beh/*_beh.tsv"))
    frames = [pd.read_csv(file, sep="\t", na_values="n/a") for file in files]
    assert [float(one) for one in ratings] == list(pd.concat(frames)["rating"])
    assert int(count) == len(ratings) > 0


def test_a_damaged_table_is_refused_with_its_line(dataset: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset, tmp_path / "copy")
    file = next((tmp_path / "copy").glob("sub-01/beh/*realism_beh.tsv"))
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:3], lines[3].rpartition("\t")[0], ""]))
    with pytest.raises(ValueError, match="line 4: must have as many cells as the first line"):
        analysis.read_bids(tmp_path / "copy")
    with pytest.raises(FileNotFoundError, match="that feel321 export --bids wrote"):
        analysis.read_bids(tmp_path)
    assert read_tsv(dataset / "participants.tsv")[0]["participant_id"] == "sub-01"
