"""`[[session.questions]]`, `[scales]` and `[tasks]`: what is allowed, and one clear line for what is not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.protocols.texts import (
    CATALOG,
    READY,
    Question,
    list_languages,
    make_scales,
    read_texts,
)
from feel321.study.settings.read import make_design, read_settings, read_study_texts

if TYPE_CHECKING:
    from pathlib import Path

SCENE = '[[recordings]]\nscene = "bumps"\n'
ASK = '[[session.questions]]\nname = "q"\nquestion = "What?"\n'


def tell(path: Path, text: str) -> list[str]:
    (path / "study.toml").write_text(SCENE + text, encoding="utf-8")
    try:
        read_settings(path / "study.toml")
    except ValueError as error:
        return [line.removeprefix("study.toml: ") for line in str(error).splitlines()]
    return []


MISTAKES = {
    "[[session.questions]]\nname = 'q'": "session.questions[1]: kind is missing; add it",
    "[[session.questions]]\nkind = 'text'\nquestion = 'A'": "session.questions[1]: name is missing",
    f"{ASK}kind = 'choise'": "session.questions[1].kind must be one of choice, number, text, likert, got",
    f"{ASK}kind = 'choice'": "session.questions[1]: options must be 2 to 9 texts for kind 'choice', got 0",
    f"{ASK}kind = 'choice'\noptions = ['a']": "options must be 2 to 9 texts for kind 'choice', got 1",
    f"{ASK}kind = 'choice'\noptions = ['a', 'a']": "options must be different texts, none",
    f"{ASK}kind = 'choice'\noptions = ['a', ' ']": "options must be different texts, none",
    f"{ASK}kind = 'choice'\noptions = {list('abcdefghij')}": "2 to 9 texts for kind 'choice', got 10",
    f"{ASK}kind = 'text'\noptions = ['a', 'b']": "options must be left out for kind 'text', got 2",
    f"{ASK}kind = 'text'\nhigh = 3": "low and high must not be numbers for kind 'text'",
    f"{ASK}kind = 'number'\nlow = 9\nhigh = 3": "low must be below high, got 9 and 3",
    f"{ASK}kind = 'number'\nlow = 'never'": "low and high must be numbers for kind 'number'",
    f"{ASK}kind = 'number'\npoints = 5": "points is for likert questions without options",
    f"{ASK}kind = 'likert'": "a likert question must have options = [...], or points = 7",
    f"{ASK}kind = 'likert'\npoints = 7": "a likert question must have options = [...], or points = 7",
    f"{ASK}kind = 'likert'\npoints = 11\nlow = 'a'\nhigh = 'b'": "session.questions[1].points",
    f"{ASK}kind = 'likert'\noptions = ['', 'b', 'c']": "options must name both ends",
    f"{ASK}kind = 'text'\nwhen = 'later'": "when must be one of before, between, after, got 'later'",
    f"{ASK}kind = 'text'\nask = true": "session.questions[1].ask: unknown setting; known: use, name",
    f"{ASK}kind = 'text'\n{ASK}kind = 'text'": "must hold each name once; more than once: q",
    "[[session.questions]]\nuse = 'demographic'": "must be one of demographics, got 'demographic'; did you",
    "[[session.questions]]\nuse = 'demographics'\npersonal = false": "brings its own questions; remove pe",
    "[[session.questions]]\nname = 'How old'\nkind = 'text'\nquestion = 'A'": "must be up to 40 lower-case l",
    "[[session.questions]]\nname = 'q'\nkind = 'text'\nquestion = ''": "question must not be empty",
    "[[session.questions]]\nuse = 'demographics'\n[[session.questions]]\nname = 'age'\nkind = 'text'\n"
    "question = 'A'": "more than once: age",
}


ROUGH = "[scales.roughness]\nquestion = 'How rough?'\nlow = 'smooth'\nhigh = 'rough'\n"

SCALE_MISTAKES = {
    "[tasks.realism]\nscales = ['realism', 'roughness']": "tasks.realism.scales: 'roughness' has no words; add [scales",
    f"{ROUGH}[tasks.realism]\nscales = ['realism', 'roughnes']": "has no words; did you mean 'roughness'? Or add",
    f"{ROUGH}[tasks.realism]\nscales = ['roughness']": "tasks.realism.scales must hold 'realism'",
    f"{ROUGH}[tasks.realism]\nscales = ['realism', 'similarity']": "must not hold the scale of another task",
    f"{ROUGH}[tasks.abx]\nscales = ['abx', 'roughness']": "tasks.abx.scales must be left out, got ['abx', 'rough",
    f"{ROUGH}[tasks.realism]\nscales = 'roughness'": "tasks.realism.scales must be a valid array, got 'roughness'",
    "[scales.roughness]\nquestion = 'How rough?'\nlow = 'smooth'": "scales.roughness.high: missing; add it",
    f"{ROUGH}high_label = 'x'": "scales.roughness.high_label: unknown setting; known: question, low, high, anchors",
    "[scales.'How rough']\nquestion = 'a'\nlow = 'b'\nhigh = 'c'": "must be up to 40 lower-case letters",
    "[scales.abx]\nquestion = 'a'\nlow = 'b'\nhigh = 'c'": "scales.abx: must not be set, the answer to abx is a choice",
    "[scales.rough]\nquestion = 'a'\nlow = 'b'\nhigh = 'b'": "scales.rough: low and high must differ, got 'b' for both",
    "[tasks.realism]\nanswer_timeout_s = 0": "tasks.realism.answer_timeout_s must be greater than 0, got 0",
    "[tasks.realism]\ngap_s = 40": "tasks.realism.gap_s must be 0 to 30, got 40",
    "[tasks.realism]\nonset_s = 0.2": "tasks.realism.onset_s must be 0.5 to 600, got 0.2",
    "[tasks.mushra]\nonset_s = 9": "tasks.mushra.onset_s must not be set: parts are felt at will",
    "[tasks.similarity]\nreference = 'surface'\nonset_s = 9": "onset_s must not be set where the real surface is",
}


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_in_a_question_has_its_line(text: str, tmp_path: Path) -> None:
    (line,) = tell(tmp_path, text)
    assert MISTAKES[text] in line
    assert line.startswith("session.questions")


@pytest.mark.parametrize("text", SCALE_MISTAKES)
def test_a_mistake_in_a_task_has_its_line(text: str, tmp_path: Path) -> None:
    (line,) = tell(tmp_path, text)
    assert SCALE_MISTAKES[text] in line


def test_scales_of_the_labs_own_reach_the_texts_and_the_tasks(tmp_path: Path) -> None:
    text = f"{ROUGH}anchors = ['a', 'b']\n[tasks.realism]\nscales = ['realism', 'roughness']\ngap_s = 0.1\n"
    assert tell(tmp_path, f"{text}answer_timeout_s = 4\nonset_s = 10") == []
    settings = read_settings(tmp_path / "study.toml")
    task = make_design(settings).tasks[0]
    assert task.scales == ("realism", "roughness")
    assert (task.gap_s, task.answer_timeout_s, task.onset_s) == (0.1, 4.0, 10.0)
    scale = make_scales(read_study_texts(settings, tmp_path))["roughness"]
    assert (scale.question, scale.low_label, scale.high_label) == ("How rough?", "smooth", "rough")
    assert scale.anchors == ("a", "b")


def test_a_file_of_the_labs_own_may_hold_its_scales(tmp_path: Path) -> None:
    own = '[scales.roughness]\nquestion = "A"\nlow_label = "B"\nhigh_label = "C"\n'
    (tmp_path / "own.toml").write_text(own, encoding="utf-8")
    use = "[session]\nlanguage = 'own.toml'\n[tasks.realism]\nscales = ['realism', 'roughness']\n"
    assert tell(tmp_path, use) == []
    settings = read_settings(tmp_path / "study.toml")
    assert make_scales(read_study_texts(settings, tmp_path))["roughness"].question == "A"
    (tmp_path / "own.toml").write_text(own.replace("high_label", "high"), encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"own.toml: scales.roughness.question is not a known text"
    ):
        read_study_texts(settings, tmp_path)
    (tmp_path / "own.toml").write_text("", encoding="utf-8")
    with pytest.raises(ValueError, match=r"tasks.realism.scales: 'roughness' has no words; add"):
        read_study_texts(settings, tmp_path)


def test_every_setting_reaches_the_design(tmp_path: Path) -> None:
    text = f"""{ASK}kind = "likert"\npoints = 4\nlow = "a"\nhigh = "d"\nwhen = "after"
        [[session.questions]]\nname = "n"\nkind = "number"\nquestion = "N"\nlow = 1\nhigh = 2.5
        personal = true\nrequired = false"""
    assert tell(tmp_path, text) == []
    assert make_design(read_settings(tmp_path / "study.toml")).questions == (
        Question("q", "likert", "What?", ("a", "", "", "d"), when="after"),
        Question("n", "number", "N", low=1.0, high=2.5, personal=True, required=False),
    )


@pytest.mark.parametrize("language", list_languages())
def test_the_ready_page_is_asked_in_the_language_of_the_study(
    language: str, tmp_path: Path
) -> None:
    use = "[[session.questions]]\nuse = 'demographics'\nwhen = 'after'\n"
    assert tell(tmp_path, f"[session]\nlanguage = '{language}'\n{use}") == []
    questions = make_design(read_settings(tmp_path / "study.toml"), tmp_path).questions
    assert [question.name for question in questions] == list(READY["demographics"])
    texts = read_texts(language)["questions"]["demographics"]
    assert [question.question for question in questions] == [
        one["question"] for one in texts.values()
    ]
    assert all(q.personal and not q.required and q.when == "after" for q in questions)
    assert [len(q.options) for q in questions] == [0, 5, 3, 3, 3]


def test_a_file_of_the_labs_own_may_ask_otherwise(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(
        '[questions.demographics.age]\nquestion = "Your age?"\n', encoding="utf-8"
    )
    use = "[session]\nlanguage = 'own.toml'\n[[session.questions]]\nuse = 'demographics'\n"
    assert tell(tmp_path, use) == []
    first, second, *_ = make_design(read_settings(tmp_path / "study.toml"), tmp_path).questions
    assert first.question == "Your age?"
    assert second.question in (CATALOG / "en.toml").read_text(encoding="utf-8")
