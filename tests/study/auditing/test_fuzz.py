"""One bad file is one finding with its name, whatever it holds; everything else is judged."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import read_journal
from tests.study.auditing.cheats import chain
from tests.study.auditing.finished import make_simulated
from tests.study.conftest import audit_study

FILES = (
    "study.toml", "rig.toml", "frozen.json", "ratings.csv", "participants.csv", "outputs.jsonl",
    "stimuli/manifest.json", "stimuli/manifest.csv", "sessions/sim001/plan.json",
    "sessions/sim001/session-01.jsonl", "sessions/sim001/withdrawn.json", "sessions/sim001/personal.jsonl",
)  # fmt: skip
JUNK = (b"", b"[1]", b"\xff\xfe\x00", b"[" * 5000, b'{"participant": 5}\n')
VALUES: tuple[Any, ...] = ("x", 5, [1], None, {"a": None})
FORGED = ("participant", "session", "presenter", "calibration", "seed", "clock", "plan_sha256")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    return make_simulated(tmp_path_factory.mktemp("fuzz") / "study")


@pytest.fixture
def copy(whole: StudyFolder, tmp_path: Path) -> StudyFolder:
    shutil.copytree(whole.path, tmp_path / "study")
    return StudyFolder(tmp_path / "study")


@pytest.mark.parametrize("name", FILES)
def test_a_bad_file_is_named_and_stops_nothing(
    copy: StudyFolder, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path, rng = copy.path / name, np.random.default_rng(7)
    before = path.read_bytes() if path.exists() else b""
    cut = before[: len(before) // 2]
    flipped = bytearray(before)
    for place in rng.integers(max(len(before), 1), size=len(before) // 50):
        flipped[place] = 48
    for content in (*JUNK, cut, flipped):
        path.write_bytes(content)
        for verb in ("status", "audit"):
            code = main([verb, str(copy.path), "--quiet"])
            told = capsys.readouterr()
            assert code in {0, 1}, (name, content[:40], told)
            said = (told.out + told.err).replace("unexpected columns", "")
            assert "unexpected" not in said, (verb, content[:40], said)
            if code and verb == "audit":
                assert path.name in said, (content[:40], said)


def test_a_forged_header_is_a_finding_and_hides_no_other(copy: StudyFolder) -> None:
    first, second = copy.journals[:2]
    header, *others = read_journal(first).records
    second.write_bytes(second.read_bytes().replace(b"test", b"tent"))
    for name in FORGED:
        for value in VALUES:
            data = json.loads(json.dumps(header.data)) | {name: value}
            chain(first, [replace(header, data=data), *others])
            found = audit_study(copy)
            assert any(line.startswith(f"{second}, line ") for line in found)
            assert sum(line.startswith(str(first)) for line in found) <= 3, (name, value, found)
