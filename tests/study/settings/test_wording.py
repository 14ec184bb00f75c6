from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING

import pytest

from feel321.protocols.texts import CATALOG, read_texts
from feel321.study.settings.read import find_language, read_settings, read_study_texts

REFUSALS = ("not_felt", "not_answered", "no_replay", "unknown_part", "too_early")

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.folder import StudyFolder

SHORTEST = '[[recordings]]\nscene = "bumps"\n[session]\n'


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_refusal_has_its_text(language: str) -> None:
    assert tuple(read_texts(language)["refusals"]) == REFUSALS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[pages]\n" + "".join(f"welcom{n}.title = 'a'\n" for n in range(1500)),
            "pages.welcome.title",
        ),
        (".".join("a" * 9000) + " = 1\n", "not valid TOML"),
    ],
)
def test_a_file_of_unknown_texts_is_refused_at_once(
    text: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "texts.toml").write_text(text, encoding="utf-8")
    begun = time.process_time()
    with pytest.raises(ValueError, match=re.escape(message)):
        read_texts(tmp_path / "texts.toml")
    assert time.process_time() - begun < 5


def test_consent_is_the_labs_own_where_it_has_one(study: StudyFolder) -> None:
    study.settings.write_text(
        f"{SHORTEST}language = 'de'\nconsent = 'Vorhaben 7'", encoding="utf-8"
    )
    pages, usual = (
        read_study_texts(read_settings(study.settings), study.path)["pages"],
        read_texts("de")["pages"],
    )
    assert pages["consent"] == {"title": usual["consent"]["title"], "text": "Vorhaben 7"}
    assert {key for key in usual if pages[key] != usual[key]} == {"consent"}


def test_a_language_of_the_labs_own_lies_beside_the_settings(study: StudyFolder) -> None:
    study.settings.write_text(f"{SHORTEST}language = 'texts/fr.toml'", encoding="utf-8")
    settings = read_settings(study.settings)
    assert find_language(settings, study.path) == study.path / "texts" / "fr.toml"
    (study.path / "texts").mkdir()
    english = (CATALOG / "en.toml").read_text(encoding="utf-8")
    (study.path / "texts" / "fr.toml").write_text(
        english.replace("Welcome", "Bienvenue"), encoding="utf-8"
    )
    assert read_study_texts(settings, study.path)["pages"]["welcome"]["title"] == "Bienvenue"
