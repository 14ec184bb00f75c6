"""What `check` finds besides the settings' own mistakes; origins of sets are tested with the provenance."""

import pytest

from feel321.stimuli.sets.build import Facts
from feel321.study.check import build_study, check_study, find_warnings
from feel321.study.folder import StudyFolder
from feel321.study.settings.read import read_settings


@pytest.fixture
def ask(study: StudyFolder) -> list[str]:
    """Settings of the small study that ask for what is not there: a picture, and texts."""
    text = study.settings.read_text(encoding="utf-8")
    text = text.replace('scene = "bumps"', 'scene = "bumps"\npicture = "pictures/oak.png"')
    study.settings.write_text(f'{text}[session]\nlanguage = "fr.toml"\n', encoding="utf-8")
    return list(check_study(study).problems)


def test_pictures_and_texts_that_are_missing_are_named(study: StudyFolder, ask: list[str]) -> None:
    assert ask == [
        f"recording 'bumps': {study.path / 'pictures' / 'oak.png'}: no such picture; put it there",
        f"{study.path / 'fr.toml'}: No such file or directory; "
        "put your texts there, or name a language of the catalogue",
    ]


@pytest.mark.parametrize(
    ("consent", "words"),
    [
        ("Read this. " * 300, "page 'consent': it must fit on one screen, got 2.5 screens; shorten it"),
        ("w" * 120, f"page 'consent': got '{'w' * 60}...', which is too long for its place; shorten it"),
    ],
)  # fmt: skip
def test_texts_that_no_screen_has_room_for_are_named(
    study: StudyFolder, consent: str, words: str
) -> None:
    text = study.settings.read_text(encoding="utf-8")
    study.settings.write_text(f'{text}[session]\nconsent = "{consent}"\n', encoding="utf-8")
    assert list(check_study(study).problems) == [f"texts in en: {words}"]


def test_every_group_that_feels_something_else_is_planned(
    study: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = study.settings.read_text(encoding="utf-8")
    text += '[between]\nprotocol = ["realism", "similarity"]\ngrip = ["pen", "power"]\n'
    study.settings.write_text(text, encoding="utf-8")
    build_study(study)
    assert list(check_study(study).problems) == []
    planned: list[int] = []

    def refuse(*_: object, number: int, **__: object) -> None:
        planned.append(number)
        raise ValueError(f"group {number} has nothing to feel")

    monkeypatch.setattr("feel321.study.check.make_plan", refuse)
    assert list(check_study(study).problems) == [
        "group 1 has nothing to feel",
        "group 2 has nothing to feel",
    ]
    assert planned == [1, 2]  # The grip changes nothing.


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("fade_s = 0.3", "recording 'bumps': fade_s must be 0 to 0.25 s, half the signal; got 0.3"),
        ("conditioning.crop_s = [0.1, 0.6]", "recording 'bumps': crop_s must be (start, end)"),
        (
            "conditioning.high_pass_hz = 6000\nconditioning.low_pass_hz = 'off'",
            "recording 'bumps': highpass must be below",
        ),
    ],
)
def test_what_a_build_would_refuse_is_found_for_every_recording(
    study: StudyFolder, text: str, problem: str
) -> None:
    settings = study.settings.read_text(encoding="utf-8").replace("[stimuli]", f"[stimuli]\n{text}")
    study.settings.write_text(settings, encoding="utf-8")
    first, second = check_study(study).problems
    assert first.startswith(problem)
    assert second.startswith("recording 'hard_taps': ")
    with pytest.raises(ValueError, match=r"^recording 'bumps': ") as caught:
        build_study(study)
    assert str(caught.value) == f"{first}\n{second}"


@pytest.mark.parametrize(("rate_hz", "count"), [(2000.0, 0), (1800.0, 1)])
def test_a_slow_recording_is_named_with_its_band(
    study: StudyFolder, rate_hz: float, count: int
) -> None:
    facts = [Facts("slow", "", rate_hz, 1.0, ())]
    found = find_warnings(study, read_settings(study.settings), facts)
    slow = [line for line in found if line.startswith("recording 'slow'")]
    assert len(slow) == count
    assert all(f"{rate_hz / 2:g} Hz" in line for line in slow)
