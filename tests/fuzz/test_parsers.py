"""Every parser, on changed files: a value or one printable refusal, soon, in little memory, touching nothing."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz import seeds
from tests.fuzz.law import Broken, law
from tests.fuzz.mutations import mutate
from tests.fuzz.parsers import PARSERS
from tests.fuzz.trial import FOUND, Trial, fold, list_found, trying

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from random import Random

every_parser = pytest.mark.parametrize("name", PARSERS)


@pytest.fixture(scope="session")
def study(make_once: Callable[..., Path]) -> Path:
    return make_once("fuzz-seeds", seeds.make_study)


@pytest.fixture
def trial(name: str, study: Path) -> Iterator[Trial]:
    with trying(name, study) as made:
        yield made


@every_parser
@settings(suppress_health_check=list(HealthCheck), derandomize=True)
@given(rng=st.randoms(use_true_random=False))
def test_changed_files(trial: Trial, name: str, rng: Random) -> None:  # noqa: ARG001 - the trial's
    """The folder is the parser's own, and each input is written over the one before."""
    trial(mutate(rng, rng.choice(trial.inputs), trial.inputs))


@every_parser
def test_valid_files_and_those_that_were_once_too_much(trial: Trial, name: str) -> None:
    values = [trial(content) for content in trial.inputs]
    assert name in SILENT or any(value is not None for value in values)


SILENT = {"recording.txt, LMT", "act of a browser"}
"""They give no value: two sisters are missing, and what a page did is queued."""


def test_what_was_found_belongs_to_a_parser() -> None:
    known = {fold(name) for name in PARSERS}
    assert {path.name for path in FOUND.iterdir()} <= known
    assert sum(len(list_found(name)) for name in PARSERS) > 0


# The law itself.


def hang() -> None:
    while True:
        pass


def swallow() -> None:
    try:
        bytearray(400 * 2**20)
    except MemoryError as error:
        raise ValueError("damaged") from error


def refuse(text: str) -> Callable[[], None]:
    def parse() -> None:
        raise ValueError(text)

    return parse


BREAKS: dict[str, Callable[[Path], Any]] = {
    "another exception": lambda _: {}["missing"],
    "no end": lambda _: hang(),
    "much memory": lambda _: bytearray(400 * 2**20),
    "much memory, worded as damage": lambda _: swallow(),
    "a written file": lambda folder: (folder / "new").write_text("x", encoding="utf-8"),
    "a removed file": lambda folder: (folder / "old").unlink(),
    "a program": lambda _: subprocess.run(["true"], check=True),
    "two lines": lambda _: refuse("one\ntwo")(),
    "an escape": lambda _: refuse("\x1b[2J")(),
    "no words": lambda _: refuse("")(),
    "an endless message": lambda _: refuse("x" * 10**5)(),
}


@pytest.mark.parametrize("way", BREAKS)
def test_the_law_sees(way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.fuzz.law.CPU_S", 0.1)
    (tmp_path / "old").touch()
    with pytest.raises(Broken), law():
        BREAKS[way](tmp_path)


def test_the_law_lets_refusals_pass() -> None:
    for error in (ValueError("a.csv: not a table"), FileNotFoundError(2, "No such file")):
        with law():
            raise error


@pytest.mark.soak
@every_parser
def test_by_coverage(name: str, study: Path, tmp_path: Path) -> None:
    if importlib.util.find_spec("atheris") is None:
        pytest.skip("NO FUZZING BY COVERAGE: atheris is not installed (pip install -e '.[fuzz]')")
    script = Path(__file__).with_name("by_coverage.py")
    words = ["--parser", name, "--seconds", "60", "--study", study, "--out", tmp_path / "out"]
    ended = subprocess.run(
        [sys.executable, script, *map(str, words)], capture_output=True, text=True, check=False
    )
    print(ended.stdout)  # noqa: T201 - the count of inputs
    assert ended.returncode == 0, (ended.stdout, ended.stderr)
