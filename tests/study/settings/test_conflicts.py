"""Settings that are allowed one by one, but not together."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from feel321.study.settings.read import find_conflicts, read_settings

if TYPE_CHECKING:
    from pathlib import Path

TWO = '[[recordings]]\nscene = "bumps"\nsample = "ridges"\n[[recordings]]\nscene = "hard_taps"\n'
ANY = "tasks.similarity: recording 'bumps', level 'as_is' "


def tell(path: Path, text: str) -> list[str]:
    """What reading the settings says, one entry per line."""
    (path / "study.toml").write_text(TWO + text, encoding="utf-8")
    try:
        assert find_conflicts(read_settings(path / "study.toml")) == []
    except ValueError as error:
        return [line.removeprefix("study.toml: ") for line in str(error).splitlines()]
    return []


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[session]\nprotocols = ['realism', 'similarity', 'dissimilarity', 'mushra', 'abx']",
        "[stimuli]\nreference = 'none'\n[session]\nprotocols = ['realism']",
        "[tasks.similarity]\nreference = 'dft321'",
        "[metrics.level_difference]\nlabel = 'level'\nhigher = 'worse'",
        # A task that no session has may be set to anything its protocol knows.
        "[tasks.mushra]\ntiming = 'free'\n[session]\nprotocols = ['realism']",
        "[stimuli]\nlevels = ['as_is', 'equal_intensity']\n[between]\nlevel = ['as_is', 'equal_intensity']",
        "[between]\nprotocol = ['realism', 'similarity']\ngrip = ['pen', 'power']",
        "[observer]\nstraight_liners = 0.5\nscale_reversers = 0.5",
        "[stimuli]\nreference = 'dft321'\nreducers = ['sax321']",
        "[session]\nrepeats = 208",
        # Each participant has one of the tasks, and the limit is on sessions.
        "[session]\nrepeats = 400\n[between]\nprotocol = ['realism', 'similarity']",
    ],
)
def test_settings_that_go_together_pass(text: str, tmp_path: Path) -> None:
    assert tell(tmp_path, text) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[tasks.mushra]\ntiming = 'strict'",
            "tasks.mushra.timing must be one of free; got 'strict'",
        ),
        (
            "[tasks.realism]\nreference = 'original'",
            "tasks.realism.reference must not be set, got 'original'",
        ),
        ("[tasks.abx]\nsurface = true", "tasks.abx.surface must be false, got true"),
        (
            "[tasks.realism]\nsurface = true",
            "recordings[2].sample: missing, but participants touch the real surface in realism",
        ),
        (
            "[tasks.similarity]\nreference = 'surface'",
            "recordings[2].sample: missing, but participants touch the real surface in similarity",
        ),
        (
            "[reducers.dft321]\ncommand = './mine {input} {output}'",
            "reducers.dft321: the name is taken by one of feel321's own",
        ),
        (
            "[reducers.original]\nuse = 'mylab:original'",
            "reducers.original: the name is taken by one of feel321's own",
        ),
        (
            "[metrics.st_sim]\nuse = 'mylab:st_sim'",
            "metrics.st_sim: the name is taken by one of feel321's own",
        ),
        (
            "[metrics.level_difference]\nhigher = 'better'",
            "metrics.level_difference.higher must be 'worse' for this metric, got 'better'",
        ),
        (
            "[stimuli]\nreference = 'dft321'",
            "stimuli.reference must not be one of stimuli.reducers too, got 'dft321'",
        ),
        (
            "[session]\nrepeats = 400",
            "a session must have at most 10000 trials, got 19200 with session.repeats = 400",
        ),
        (
            "[between]\nlevel = ['equal_intensity']",
            "between.level must be one of as_is, got 'equal_intensity'; or add it",
        ),
        (
            "[between]\nprotocol = ['abx']",
            "between.protocol must be one of realism, similarity, got 'abx'; or add it to",
        ),
        (
            "[observer]\nrandom_clickers = 0.6\nscale_reversers = 0.6",
            "observer: straight_liners, random_clickers, scale",
        ),
        (
            "[tasks.similarity]\nreference = 'dft'",
            ANY + "must have exactly one stimulus for the reference 'dft', got 0",
        ),
        (
            "[stimuli]\nreference = 'none'",
            ANY + "must have exactly one stimulus for the reference 'original', got 0",
        ),
    ],
)
def test_each_conflict_is_one_line(text: str, message: str, tmp_path: Path) -> None:
    (told,) = tell(tmp_path, text)
    assert told.startswith(message)


def test_a_page_of_mushra_has_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "[session]\nprotocols = ['mushra']"
    assert tell(tmp_path, text) == []
    # There are just as many reducers as a page holds: one place less, and it is too full.
    monkeypatch.setattr("feel321.protocols.compare.MUSHRA_MOST", 11)
    (told,) = tell(tmp_path, text)
    assert told.startswith(
        "tasks.mushra: recording 'bumps', level 'as_is': a page of mushra must have at most 11"
    )


def test_a_task_that_no_group_has_wants_nothing(tmp_path: Path) -> None:
    text = "[stimuli]\nreference = 'none'\n"
    assert len(tell(tmp_path, text)) == 1
    assert tell(tmp_path, f"{text}[between]\nprotocol = ['realism']") == []


def test_what_follows_from_a_conflict_is_not_told_as_well(tmp_path: Path) -> None:
    told = tell(
        tmp_path,
        "[tasks.realism]\ntiming = 'free'\nsurface = true\n[tasks.mushra]\nreference = 'surface'\n"
        "[between]\nlevel = ['as_is', 'equal_intensity']\nprotocol = ['abx', 'mushra']\n",
    )
    assert [re.split(r"[: ]", line)[0] for line in told] == [
        "tasks.realism.timing",
        "tasks.mushra.reference",
        "between.level",
        "between.protocol",
        "between.protocol",
    ]
