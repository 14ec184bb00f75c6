import re
from pathlib import Path

import pytest

from feel321.protocols.tasks import CHOICES, PROTOCOLS
from feel321.protocols.texts import (
    CATALOG,
    MODEL,
    find_gaps,
    list_languages,
    read_scales,
    read_texts,
)  # fmt: skip
from feel321.protocols.threshold import INTERVALS
from feel321.protocols.trial import MATCHING, THRESHOLD

# Which words stand at 0 and at 100 points, and along the slider: swapped, they would turn every rating round.
ENDS = {
    "realism": ("Not at all real", "Like touching the real surface",
                "Überhaupt nicht echt", "Wie die echte Oberfläche"),
    "similarity": ("Completely different", "Identical", "Völlig verschieden", "Identisch"),
    "dissimilarity": ("Identical", "Completely different", "Identisch", "Völlig verschieden"),
    "mushra": ("Not at all", "Just like the reference", "Überhaupt nicht", "Genau wie die Referenz"),
    "abx": ("Wrong", "Right", "Falsch", "Richtig"),
    "triplet": ("B", "A", "B", "A"),
    "preference": ("B", "A", "B", "A"),
    "threshold": ("Wrong", "Right", "Falsch", "Richtig"),
    "matching": ("Weaker", "Stronger", "Schwächer", "Stärker"),
}  # fmt: skip
ALONG = {
    "en": ("Bad", "Poor", "Fair", "Good", "Excellent"),
    "de": ("Schlecht", "Dürftig", "Ordentlich", "Gut", "Ausgezeichnet"),
}


@pytest.fixture
def english() -> str:
    return (CATALOG / f"{MODEL}.toml").read_text(encoding="utf-8")


@pytest.fixture
def own(tmp_path: Path, english: str) -> Path:
    """A file of the lab's own, complete."""
    path = tmp_path / "fr.toml"
    path.write_text(english.replace("Thank you", "Merci"), encoding="utf-8")
    return path


@pytest.mark.parametrize("language", list_languages())
def test_every_language_is_complete_and_has_the_scale_of_every_protocol(language: str) -> None:
    assert list(find_gaps(read_texts(language), read_texts(MODEL))) == []
    scales = read_scales(language)
    assert set(scales) == set(PROTOCOLS) | {THRESHOLD, MATCHING}
    assert all(name == scale.name for name, scale in scales.items())
    introduced = {key.partition(".")[2] for key in read_texts(language)["pages"] if "." in key}
    assert introduced == set(scales)
    assert all(
        scale.question.endswith("?") and scale.low_label != scale.high_label
        for scale in scales.values()
    )
    chosen = dict.fromkeys(("abx", "triplet", "preference"), CHOICES) | {THRESHOLD: INTERVALS}
    assert {name: scale.choices for name, scale in scales.items() if scale.choices} == chosen
    assert [name for name, scale in scales.items() if scale.anchors] == ["mushra"]


def test_both_ends_of_every_scale_are_where_they_belong() -> None:
    scales = {language: read_scales(language) for language in ("en", "de")}
    found = {
        name: tuple(
            label
            for own in scales.values()
            for label in (own[name].low_label, own[name].high_label)
        )
        for name in scales["en"]
    }
    assert found == ENDS
    assert {language: own["mushra"].anchors for language, own in scales.items()} == ALONG


def test_unknown_language_is_refused_with_the_list(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^language must be one of de, en; got 'xx'"):
        read_scales("xx")
    (tmp_path / "texts.toml").write_text('language = "fr"', encoding="utf-8")
    with pytest.raises(ValueError, match="language must be one of de, en, got 'fr'; it gives"):
        read_texts(tmp_path / "texts.toml")


def test_all_gaps_of_an_own_file_are_told_at_once(own: Path, english: str) -> None:
    text = re.sub(r"(?s)\[pages\.rest\].*?(?=\[pages)", "", english)
    text = text.replace('"Fair", ', "").replace('choices = ["a", "b"]', 'choices = ["a", "c"]', 1)
    text = text.replace("Not yet played: {parts}", "{part}").replace("[keys]", '[keys]\nfly = "F"')
    own.write_text(text.replace('title = "Welcome back"', "title = 5"), encoding="utf-8")
    with pytest.raises(ValueError, match="is missing") as caught:
        read_texts(own)
    told = [
        line.removeprefix(f"{own}: ").partition("; compare ")
        for line in str(caught.value).splitlines()
    ]
    assert {remedy for _, _, remedy in told} == {"protocols/catalog/en.toml"}
    assert {gap.partition(", did you")[0] for gap, _, _ in told} >= {
        "scales.abx.choices[2] must be 'b', got 'c': choices are names of parts, the same in every language",
        "pages.warm_up.title must be a text, got 5",
        "refusals.not_felt must have the placeholders {parts}, got {part}",
        "scales.mushra.anchors[5] is missing",
        "keys.fly is not a known text",
    }


def test_an_own_file_may_hold_only_what_it_changes(tmp_path: Path) -> None:
    """All else is of the language that it names."""
    path = tmp_path / "texts.toml"
    for language in list_languages():
        path.write_text(
            f'language = "{language}"\n[pages.end]\ntitle = "Merci"\n[scales.mushra]\n'
            'anchors = ["1", "2", "3", "4", "5"]\n',
            encoding="utf-8",
        )
        own, usual = read_texts(path), read_texts(language)
        usual["pages"]["end"]["title"] = "Merci"
        usual["scales"]["mushra"]["anchors"] = ["1", "2", "3", "4", "5"]
        assert own == usual


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('[pages.ends]\ntitle = "x"', "pages.ends.title is not a known text, did you mean pages.end.title?"),
        ('[keys]\nmoves = "x  y"', "keys.moves is not a known text, did you mean keys.move?"),
        ('[prompts]\nfeel = "x"', "prompts.feel must have the placeholders {part}, got none"),
        ('[scales.mushra]\nanchors = ["a", "b"]', "scales.mushra.anchors[3] is missing"),
    ],
)  # fmt: skip
def test_mistakes_in_a_few_lines_are_named(text: str, fault: str, tmp_path: Path) -> None:
    path = tmp_path / "texts.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match="compare protocols") as caught:
        read_texts(path)
    assert str(caught.value).splitlines()[0].removeprefix(f"{path}: ").startswith(fault)
