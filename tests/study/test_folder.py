from pathlib import Path

from feel321.study.folder import StudyFolder


def test_what_drives_and_programs_leave_beside_participants_is_no_participant(
    tmp_path: Path,
) -> None:
    study = StudyFolder(tmp_path)
    assert study.participants == study.strangers == study.journals == []
    for name in ("p02", "p01", "empty", "locked", "@eaDir", "sim001 backup", ".snapshot"):
        (study.sessions / name).mkdir(parents=True)
        if name != "empty":
            (study.sessions / name / ".lock").touch()
        if name not in {"empty", "locked"}:
            (study.sessions / name / "session-01.jsonl").touch()
    for name in ("p03", ".DS_Store"):
        (study.sessions / name).touch()
    assert [folder.name for folder in study.participants] == ["p01", "p02"]
    assert [entry.name for entry in study.strangers] == ["@eaDir", "p03", "sim001 backup"]


def test_journals_come_by_number_and_copies_are_none(tmp_path: Path) -> None:
    folder = tmp_path / "sessions" / "p01"
    folder.mkdir(parents=True)
    for name in (
        "session-100",
        "session-20",
        "session-03",
        "session-3",
        "session-03 (copy)",
        "session-xx",
    ):
        (folder / f"{name}.jsonl").touch()
    assert [path.stem for path in StudyFolder(tmp_path).journals] == [
        "session-03",
        "session-20",
        "session-100",
    ]
