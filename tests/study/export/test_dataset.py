"""What an export holds and what it must not hold; the validators of the standards read it."""

import json
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from feel321.study import export as dataset_module
from feel321.study.analyze import analyze_study
from feel321.study.export import KEY_FILE, NO_METHODS, export_bids
from feel321.study.folder import StudyFolder
from tests.study.export.conftest import PLANTED

VALIDATOR = Path(sys.executable).with_name("bids-validator-deno")

UNAVOIDABLE = {
    ("JSON_KEY_RECOMMENDED", "HEDVersion"),  # nothing is tagged with HED
    ("SIDECAR_KEY_RECOMMENDED", "CogAtlasID"),  # no such term for what is asked here
    ("SIDECAR_KEY_RECOMMENDED", "CogPOID"),
    ("JSON_KEY_RECOMMENDED", "License"),  # CITATION.cff has it, and BIDS wants it said once
    ("TOO_FEW_AUTHORS", ""),  # the same, and an error otherwise
}
"""Warnings that remain: what they ask for does not exist, or the standard forbids it in the same breath."""


def validate(folder: Path) -> Counter[tuple[str, str, str]]:
    """Count the issues that the standard's own validator finds."""
    command = [str(VALIDATOR), str(folder), "--format", "json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    issues = json.loads(done.stdout)["issues"]["issues"]
    return Counter((one["severity"], one["code"], one.get("subCode", "")) for one in issues)


def read_all(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_the_validator_of_bids_finds_no_error_and_no_avoidable_warning(dataset: Path) -> None:
    found = validate(dataset)
    assert {key for key in found if key[0] == "error"} == set()
    assert {key[1:] for key in found} <= UNAVOIDABLE


def test_nothing_that_identifies_anybody_is_exported(studied: StudyFolder, dataset: Path) -> None:
    journals = b"".join(path.read_bytes() for path in studied.journals)
    for place, planted in PLANTED.items():
        if place != "withdrawn":
            assert planted.encode() in journals, f"{place} was not planted"
    for name, content in read_all(dataset).items():
        assert [p for p in PLANTED.values() if p.encode().lower() in content.lower()] == [], name
        assert [p for p in PLANTED.values() if p.lower() in name.lower()] == []
        assert str(studied.path).encode() not in content
    assert (studied.path / KEY_FILE).read_text().strip().encode() not in b"".join(
        read_all(dataset).values()
    )


def test_who_withdrew_and_who_is_a_program_stays_out(
    dataset: Path, export: Callable[..., Path]
) -> None:
    people = pd.read_csv(dataset / "participants.tsv", sep="\t", dtype=str)
    assert list(people["participant_id"]) == ["sub-01", "sub-02"]
    assert set(people["simulated"]) == {"false"}
    assert "age" not in people
    assert "number" not in people
    everybody = pd.read_csv(export(simulated=True) / "participants.tsv", sep="\t", dtype=str)
    assert sorted(everybody["simulated"]) == ["false", "false", "true"]


def test_the_same_study_gives_the_same_bytes(dataset: Path, export: Callable[..., Path]) -> None:
    assert read_all(export()) == read_all(dataset)


def test_nothing_is_overwritten(studied: StudyFolder, dataset: Path, tmp_path: Path) -> None:
    before = read_all(dataset)
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for taken in (dataset, studied.path, tmp_path / "link"):
        with pytest.raises(FileExistsError, match="already holds something; name a new or empty"):
            export_bids(studied, taken)
    assert read_all(dataset) == before
    (tmp_path / "empty").mkdir()
    export_bids(studied, tmp_path / "empty")
    assert read_all(tmp_path / "empty") == before


def test_pandas_reads_the_studys_own_ratings(studied: StudyFolder, dataset: Path) -> None:
    own = pd.read_csv(studied.ratings)
    files = sorted(dataset.glob("sub-*/beh/*_beh.tsv"))
    read = pd.concat([pd.read_csv(file, sep="\t", na_values="n/a") for file in files])
    columns = ["stimulus_id", "scale", "trial", "rating", "onset_s", "response_time_s"]
    real = own.loc[~own["simulated"], columns].sort_values(columns, ignore_index=True)
    found = read[columns].sort_values(columns, ignore_index=True)
    pd.testing.assert_frame_equal(found, real, check_exact=True)


def test_the_methods_are_there_once_a_report_is_of_these_ratings(
    studied: StudyFolder, tmp_path: Path
) -> None:
    copied = StudyFolder(tmp_path / "copy")
    shutil.copytree(studied.path, copied.path)
    assert NO_METHODS in export_bids(copied, tmp_path / "without")
    assert not (tmp_path / "without" / "methods.md").exists()
    analyze_study(copied)
    assert export_bids(copied, tmp_path / "with") == []
    text = (tmp_path / "with" / "methods.md").read_text(encoding="utf-8")
    assert [planted for planted in PLANTED.values() if planted in text] == []
    assert {key for key in validate(tmp_path / "with") if key[0] == "error"} == set()


def test_every_column_has_a_meaning(dataset: Path) -> None:
    for name in ("participants", "stimuli/stimuli"):
        about = json.loads((dataset / f"{name}.json").read_text())
        assert [key for key, one in about.items() if one["Description"].startswith("column ")] == []
    about = json.loads((dataset / "task-realism_beh.json").read_text())
    table = pd.read_csv(next(dataset.glob("sub-01/beh/*realism_beh.tsv")), sep="\t")
    assert set(table) <= set(about)
    assert about["rating"]["Units"] == "points"
    assert "How real did this vibration feel?" in about["TaskDescription"]


@pytest.mark.parametrize("last", ["participants.tsv", "README"])
def test_an_interrupted_export_leaves_nothing(
    studied: StudyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: str
) -> None:
    write = dataset_module._write

    def stop(path: Path, content: str) -> None:
        write(path, content)
        if path.name == last:
            raise KeyboardInterrupt

    monkeypatch.setattr(dataset_module, "_write", stop)
    with pytest.raises(KeyboardInterrupt):
        export_bids(studied, tmp_path / "fresh")
    assert list(tmp_path.iterdir()) == []


def test_an_export_is_its_owners_alone(dataset: Path) -> None:
    assert {path.stat().st_mode & 0o077 for path in dataset.rglob("*")} == {0}
