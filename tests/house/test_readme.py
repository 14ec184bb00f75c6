"""The README's commands exist, and every verb of the command line stands in it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import click
import pytest

from study import cli

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def readme(root: Path) -> str:
    return (root / "README.md").read_text(encoding="utf-8")


def make_commands(text: str) -> list[str]:
    return re.findall(r"\bmake ([a-z]+)\b", "\n".join(code_in(text)))


def code_in(text: str) -> list[str]:
    """Fenced blocks and inline code, in that order."""
    fenced = re.findall(r"^```.*?\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [*fenced, *re.findall(r"`([^`\n]+)`", text)]


def verbs_told(text: str) -> set[str]:
    return set(re.findall(r"\bfeel321 ([a-z]+)\b", "\n".join(code_in(text))))


def test_the_two_commands_come_first(readme: str) -> None:
    assert make_commands(readme)[:2] == ["demo", "test"]


def test_every_make_command_is_a_target(readme: str, root: Path) -> None:
    targets = set(re.findall(r"^([a-z]+):", (root / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(make_commands(readme)) - targets == set()


def test_every_verb_is_told_and_no_other(readme: str) -> None:
    (group,) = (thing for thing in vars(cli).values() if isinstance(thing, click.Group))
    assert verbs_told(readme) == set(group.commands)


def test_code_is_told_from_prose() -> None:
    text = "To make sense:\n```sh\nmake demo\nfeel321 build\n```\nthen `make test`, feel321 run\n"
    assert make_commands(text) == ["demo", "test"]
    assert verbs_told(text) == {"build"}
