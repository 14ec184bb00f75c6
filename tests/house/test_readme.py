"""README and docs: short, complete, linked, and every command, option, import and setting in them exists."""

from __future__ import annotations

import ast
import re
import tomllib
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
import pytest

from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.synthesis import make_scene
from feel321.study import cli
from feel321.study.actuator.rig import read_rig
from feel321.study.commands import shared
from feel321.study.folder import add_methods, create_study
from feel321.study.settings.read import read_settings

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

README_LENGTH = 4500
"""Characters that README may have; the rest is in docs/."""

PAGES, WORDS = 12, 12_000
"""Pages that people write in docs/, and their words; all else of the site is made from the code."""

RIG = 'device = { name = "file" }\nlimits = { peak_m_s2 = 100.0, rms_m_s2 = 50.0, duration_s = 30.0 }\n'
RECORDING = '[[recordings]]\nscene = "bumps"\n'


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block of a page."""

    page: str
    language: str
    text: str


@pytest.fixture(scope="module")
def pages(root: Path) -> dict[str, str]:
    """README and the pages of docs/, by their path in the project."""
    paths = [root / "README.md", *sorted((root / "docs").glob("*.md"))]
    return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in paths}


@pytest.fixture(scope="module")
def others(root: Path) -> dict[str, str]:
    """Pages for those who change the code or report a flaw."""
    names = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
    return {name: (root / name).read_text(encoding="utf-8") for name in names}


@pytest.fixture(scope="module")
def readme(pages: dict[str, str]) -> str:
    return pages["README.md"]


@pytest.fixture(scope="module")
def blocks(pages: dict[str, str]) -> tuple[Block, ...]:
    return tuple(block for page, text in pages.items() for block in blocks_in(page, text))


@pytest.fixture(scope="module")
def verbs() -> dict[str, set[str]]:
    """The options of every verb."""
    return {
        verb: {name for one in cli.APP[verb].assemble_argument_collection() for name in one.names}
        for verb in cli.VERBS
    }


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the pages' examples name."""
    folder = tmp_path_factory.mktemp("lab")
    oak = make_scene("texture_drag")
    seconds = np.arange(oak.acceleration.shape[1]) / oak.rate_hz
    columns = np.column_stack([seconds, oak.acceleration.T / 9.80665])
    np.savetxt(folder / "oak.csv", columns, delimiter=",", header="time_s,x,y,z", comments="")
    (folder / "stimuli").mkdir()
    rng = np.random.default_rng(0)
    stimuli = [(f"{scene}-{name}", scene, name) for scene in "abcd" for name in list(REDUCERS)[:4]]
    manifest = [f"{','.join(names)},{rng.random()},{rng.random()}" for names in stimuli]
    header = "stimulus_id,recording,reducer,spectral_match_bounded,temporal_match"
    write(folder / "stimuli" / "manifest.csv", "\n".join([header, *manifest]))
    ratings = [
        f"p{who},{names[0]},realism,{rng.uniform(20, 80)}" for who in range(4) for names in stimuli
    ]
    write(folder / "ratings.csv", "\n".join(["participant,stimulus_id,scale,rating", *ratings]))
    return folder


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def blocks_in(page: str, text: str) -> Iterator[Block]:
    for language, inside in re.findall(r"^```(\w*)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        yield Block(page, language, inside)


def make_commands(text: str) -> list[str]:
    return re.findall(r"\bmake ([a-z]+)\b", "\n".join(code_in(text)))


def code_in(text: str) -> list[str]:
    """Fenced blocks and inline code, in that order."""
    fenced = [block.text for block in blocks_in("", text)]
    outside = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    return [*fenced, *re.findall(r"`([^`\n]+)`", outside)]


def verbs_in(text: str) -> set[str]:
    return set(re.findall(r"(?<!from )\bfeel321 ([a-z]+)\b", "\n".join(code_in(text))))


def calls_in(text: str) -> Iterator[tuple[str, list[str]]]:
    """Every call of the command line: its verb and its options."""
    for line in re.findall(r"(?<!from )\bfeel321 ([a-z]+ [^#\n]*)", "\n".join(code_in(text))):
        verb, _, rest = line.partition(" ")
        yield verb, re.findall(r"(?<!\S)--?[a-z][a-z-]*", rest)


def unknown_options(text: str, verbs: dict[str, set[str]]) -> list[str]:
    return [
        f"{verb} {option}"
        for verb, options in calls_in(text)
        for option in options
        if option not in {"--help", *shared.SWITCHES, *verbs[verb]}
    ]


def anchor(heading: str) -> str:
    return re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")


def dead_links(path: Path, text: str) -> list[str]:
    """Links to no file of the project, or to no heading of it."""
    found = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        name, _, heading = target.partition("#")
        if name.startswith("https://"):
            continue
        file = path.parent / name if name else path
        headings = (
            re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            if heading
            else []
        )
        if not file.is_file() or (heading and heading not in map(anchor, headings)):
            found.append(target)
    return found


def missing_imports(text: str) -> list[str]:
    """What a Python block imports from the project and is in no face there."""
    imports = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
    ours = [
        node
        for node in imports
        if node.module and node.module.split(".")[-1] in {"stimuli", "analysis"}
    ]
    faces = {node.module: import_module(node.module).__all__ for node in ours if node.module}
    return [
        each.name
        for node in ours
        for each in node.names
        if node.module and each.name not in faces[node.module]
    ]


def test_the_readme_is_short(readme: str) -> None:
    assert len(readme) <= README_LENGTH


def test_the_two_commands_come_first(readme: str) -> None:
    assert make_commands(readme)[:2] == ["demo", "test"]


def test_every_make_command_is_a_target(
    pages: dict[str, str], others: dict[str, str], root: Path
) -> None:
    targets = set(
        re.findall(r"^([a-z]+):", (root / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert {
        command for text in (pages | others).values() for command in make_commands(text)
    } - targets == set()


def test_the_pages_are_few_and_short(pages: dict[str, str]) -> None:
    written = [text for page, text in pages.items() if page != "README.md"]
    assert len(written) <= PAGES
    assert sum(len(text.split()) for text in written) <= WORDS


def test_every_verb_is_described_and_no_other(
    pages: dict[str, str], verbs: dict[str, set[str]]
) -> None:
    assert set().union(*map(verbs_in, pages.values())) == set(verbs)


def test_every_option_exists(pages: dict[str, str], verbs: dict[str, set[str]]) -> None:
    assert [
        (page, each) for page, text in pages.items() for each in unknown_options(text, verbs)
    ] == []


def test_every_page_is_linked_from_the_readme(pages: dict[str, str]) -> None:
    linked = set(re.findall(r"\]\((docs/[\w-]+\.md)\)", pages["README.md"]))
    assert linked == set(pages) - {"README.md"}


def test_installation_is_in_one_place(pages: dict[str, str]) -> None:
    told = [page for page, text in pages.items() if "pip install -c constraints.txt" in text]
    assert told == ["docs/quickstart.md"]


def test_every_picture_is_on_a_page(pages: dict[str, str], root: Path) -> None:
    shown = {
        (root / page).parent / target
        for page, text in pages.items()
        for target in re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    }
    kept = {path for kind in ("png", "svg") for path in (root / "docs").rglob(f"*.{kind}")}
    assert kept == shown


def test_every_link_leads_somewhere(
    pages: dict[str, str], others: dict[str, str], root: Path
) -> None:
    assert [
        (page, each)
        for page, text in (pages | others).items()
        for each in dead_links(root / page, text)
    ] == []


def test_every_import_is_public(blocks: tuple[Block, ...]) -> None:
    python = [block for block in blocks if block.language == "python"]
    assert python
    assert [
        (block.page, missing) for block in python if (missing := missing_imports(block.text))
    ] == []


def test_every_python_block_runs(
    blocks: tuple[Block, ...], lab: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(lab)
    for block in blocks:
        if block.language == "python":
            exec(compile(block.text, block.page, "exec"), {})  # noqa: S102 - that a reader may paste it is the point
    plt.close("all")


def test_every_setting_is_accepted(blocks: tuple[Block, ...], tmp_path: Path) -> None:
    """What a page shows of study.toml or rig.toml is read once what it leaves out is added."""
    toml = [block.text for block in blocks if block.language == "toml"]
    assert toml
    add_methods(create_study(tmp_path))  # whose files pages name
    (tmp_path / "corpus").mkdir()
    for number in range(20):
        (tmp_path / "corpus" / f"tap{number}.wav").touch()
    for text in toml:
        given = tomllib.loads(text)
        if {"actuators", "keys"} & given.keys():
            read_rig(write(tmp_path / "rig.toml", RIG + text))
        else:
            read_settings(
                write(tmp_path / "study.toml", ("" if "recordings" in given else RECORDING) + text)
            )


def test_the_readme_counts_the_reducers(readme: str) -> None:
    assert re.findall(r"all (\d+) reducers", readme) == [str(len(REDUCERS))]


def test_code_is_separated_from_prose() -> None:
    block = "```sh\nmake demo\nfeel321 build\nfrom feel321 import study\n```"
    text = f"To make sense:\n{block}\nthen `make test`, feel321 run\n"
    assert make_commands(text) == ["demo", "test"]
    assert verbs_in(text) == {"build"}


def test_an_unknown_option_is_found(verbs: dict[str, set[str]]) -> None:
    text = "`feel321 build oak-study --workers 2`, `feel321 build oak-study --jobs 2  # --workers`"
    assert unknown_options(text, verbs) == ["build --jobs"]


def test_a_dead_link_is_found(tmp_path: Path) -> None:
    page, other = tmp_path / "page.md", tmp_path / "other.md"
    other.write_text("# Level arms\n", encoding="utf-8")
    text = "[a](other.md) [b](other.md#level-arms) [c](https://example.org) [d](gone.md) [e](other.md#anchors)"
    assert dead_links(page, text) == ["gone.md", "other.md#anchors"]


def test_a_private_import_is_found() -> None:
    assert missing_imports(
        "from feel321.stimuli import REDUCERS, no_such_reducer\nimport numpy\n"
    ) == ["no_such_reducer"]
