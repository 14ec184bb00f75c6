"""A lab's own keys: what rig.toml may say, what they do in every task, and what the screen calls them."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.texts import list_languages, read_scales, read_texts
from feel321.protocols.trial import Judgement, Part, Trial
from feel321.study.actuator.rig import read_rig
from feel321.study.keys import KEY_NAMES, USUAL, KeysTable
from feel321.study.screen.input import Answer, InputEvent, make_screen_texts

LIMITS = "[limits]\npeak_m_s2 = 100.0\nrms_m_s2 = 50.0\nduration_s = 30.0\n"


def read(folder: Path, keys: str) -> KeysTable:
    (folder / "rig.toml").write_text(f"{LIMITS}[keys]\n{keys}\n", encoding="utf-8")
    return read_rig(folder / "rig.toml").keys


def test_one_key_or_several_for_an_action(tmp_path: Path) -> None:
    keys = read(tmp_path, 'next = ["enter", "b"]\nstop = "period"')
    assert [keys.name_action(key) for key in ("enter", "b", "period", "space", "f2", "7")] == [
        "next", "next", "stop", "", "play 2", "type_values",
    ]  # fmt: skip
    assert keys.find_key("next") == "enter"
    assert keys.again == USUAL.again


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            'next = "space"',
            "rig.toml: keys: got 'space' for next and stop, but a key does one thing; change one of them",
        ),
        (
            'play = ["1", "2"]',
            "rig.toml: keys: got '1' for play 1 and type_values, but a key does one thing; change one of them",
        ),
        (
            'next = "Enter"',
            "rig.toml: keys.next must be keys, a letter, a digit, f1 to f24 or a name such as enter, space, pageup, "
            "comma, got 'Enter'; did you mean 'enter'?",
        ),
        ("next = []", "rig.toml: keys.next must hold at least one name, got []"),
        ('nxt = "b"', "rig.toml: keys.nxt: unknown setting; did you mean next?"),
    ],
)
def test_keys_that_cannot_be_are_named(tmp_path: Path, line: str, words: str) -> None:
    with pytest.raises(ValueError, match="keys") as caught:
        read(tmp_path, line)
    assert str(caught.value) == words


@pytest.mark.parametrize("language", list_languages())
def test_the_screen_names_the_keys_that_are_there(language: str) -> None:
    tables = read_texts(language)
    usual = make_screen_texts(tables)
    changed = {"feel", "loop", "confirm_typed"}
    assert {k: v for k, v in usual.keys.items() if k not in changed} == {
        k: v for k, v in tables["keys"].items() if k not in changed
    }
    assert usual.prompts == tables["prompts"]
    assert usual.keys["feel"].startswith("Tab F1–F9  ")
    keys = KeysTable(
        next=("b", "enter"), pause=("p",), experimenter=("f10",), left=("comma",), play=("q", "w")
    )
    own = make_screen_texts(tables, keys)
    does = {name: line.partition("  ")[2] for name, line in tables["keys"].items()}
    assert own.keys["confirm"] == f"B  {does['confirm']}"
    assert own.keys["confirm_typed"] == tables["keys"]["confirm"]  # where B types a letter
    assert own.keys["move"] == f"Comma →  {does['move']}"
    assert own.keys["feel"] == f"Tab Q–W  {does['feel']}"
    twice = tables["keys"]["pause"].partition("  ")[0].partition(" ")[2]
    assert own.keys["pause"] == f"P {twice}  {does['pause']}"
    assert own.prompts["experimenter"].endswith("F10")
    assert " P " in own.prompts["pause_next"]
    assert " B " in own.prompts["surface"].replace(",", " ")
    assert own.keys["stop"] == usual.keys["stop"]


TIMED = {"slider": "replay", "rows": "free", "choice": "replay"}
SCALES = {"slider": "similarity", "rows": "mushra", "choice": "abx"}
PARTS = {
    "slider": ("reference", "test"),
    "rows": ("reference", "1", "2"),
    "choice": ("a", "b", "x"),
}


def make_answer(kind: str, keys: KeysTable) -> Answer:
    names = PARTS[kind]
    judged = names[1:] if kind == "rows" else names[-1:]
    trial = Trial(
        1, 1, 1, SCALES[kind], SCALES[kind], TIMED[kind], "oak",
        tuple(Part(name, "s1") for name in names), tuple(Judgement(name, "s1") for name in judged),
    )  # fmt: skip
    answer = Answer(trial, read_scales()[SCALES[kind]], keys)
    answer.felt = frozenset(names)
    return answer


def press(kind: str, key: str, keys: KeysTable = USUAL) -> dict[str, Any]:
    """What a key does in a task in which everything was felt: what is asked for, and the answer."""
    answer = make_answer(kind, keys)
    request = answer.take(InputEvent("press", 1.0, key), None, can_answer=True)
    answer.take(InputEvent("release", 1.1, key), None, can_answer=True)
    answer.tick(3.0, can_answer=True)
    feels = request.part if request else None
    return {"feels": feels, "values": answer.values, "row": answer.selected}


@given(st.sampled_from(KEY_NAMES))
def test_a_key_does_the_same_in_every_task_or_nothing(key: str) -> None:
    """By key: what is felt, where a marker goes, which row is selected; never two of them in different tasks."""
    idle = {kind: press(kind, "f24") for kind in TIMED}
    does = set()
    for kind in TIMED:
        after = press(kind, key)
        if after["feels"] is not None:
            does.add("feels")
        elif after["values"] != idle[kind]["values"]:
            does.add("answers")
        elif after["row"] != idle[kind]["row"]:
            does.add("selects")
    assert len(does) <= 1


def test_the_same_keys_feel_and_move_in_every_task() -> None:
    assert {kind: press(kind, "f1")["feels"] for kind in TIMED} == {
        "slider": "test", "rows": "1", "choice": "a",
    }  # fmt: skip
    assert [press(kind, "tab")["feels"] for kind in ("slider", "rows")] == ["reference"] * 2
    assert press("slider", "7")["values"] == {"test": 7.0}
    assert press("rows", "7")["values"] == {"1": 7.0}
    assert press("choice", "1")["values"] == {}
    assert [press("choice", key)["values"]["x"] for key in ("left", "right", "b")] == [
        "a",
        "b",
        "b",
    ]
    box = KeysTable(play=("1", "2", "3"), left=("4",), right=("5",), type_values=False)
    assert press("rows", "2", box)["feels"] == "2"
    assert press("choice", "5", box)["values"] == {"x": "b"}
    assert make_screen_texts(read_texts(), box).keys["feel"] == "Tab 1–3  feel one"
