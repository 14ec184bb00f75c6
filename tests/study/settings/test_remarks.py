from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.study.folder import list_bundled, read_bundled, read_template
from feel321.study.settings.read import list_remarks, read_settings

if TYPE_CHECKING:
    from pathlib import Path

SHORTEST = '[[recordings]]\nscene = "bumps"\n'


def tell(path: Path, text: str) -> list[str]:
    (path / "study.toml").write_text(text, encoding="utf-8")
    return list_remarks(read_settings(path / "study.toml"))


@pytest.mark.parametrize("text", [read_template(), *map(read_bundled, list_bundled())])
def test_nothing_is_to_be_said_about_what_we_ship(text: str, tmp_path: Path) -> None:
    assert tell(tmp_path, text) == []


@pytest.mark.parametrize(
    ("text", "remark"),
    [
        (
            "[tasks.mushra]\ntiming = 'free'",
            "tasks.mushra: has no effect, mushra is not in session.protocols; add",
        ),
        (
            "[stimuli]\nanchors = false\n[session]\nprotocols = ['mushra']",
            "stimuli.anchors: false, but a page of mushra",
        ),
        (
            "[session.rehearsal]\npractice = 0",
            "session.stale.policy: 'warm_up' needs practice, but session.rehearsal.practice is",
        ),
        ("[session.breaks]\nrest_s = 0", "session.breaks.rest_s: 0 leaves fingertips no rest"),
    ],
)
def test_each_remark_is_one_line(text: str, remark: str, tmp_path: Path) -> None:
    (told,) = tell(tmp_path, SHORTEST + text)
    assert told.startswith(remark)
    assert "\n" not in told


@pytest.mark.parametrize(
    "text",
    [
        "[stimuli]\nanchors = false",
        "[session]\nprotocols = ['mushra']",
        "[session.rehearsal]\npractice = 0\n[session.stale]\npolicy = 'continue'",
        "[session.rehearsal]\npractice = 0\n[session.stale]\nafter_h = 'off'",
        "[tasks.similarity]\ntiming = 'strict'",
    ],
)
def test_what_is_meant_needs_no_remark(text: str, tmp_path: Path) -> None:
    assert tell(tmp_path, SHORTEST + text) == []
