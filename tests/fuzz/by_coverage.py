"""Fuzzing by coverage: atheris changes what takes a parser to new lines. Each parser runs in a process of its own.

    python tests/fuzz/by_coverage.py --seconds 60 --parser recording.wav --parser journal

Prints a row per parser: inputs, time, speed, share that gave a value, peak memory, inputs that broke the law. Those are
kept in `tests/fuzz/found`, from where every later run of the tests tries them again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import types
from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from collections.abc import Sequence

HERE = Path(__file__).resolve().parent
MOST_BYTES = 2**16
RESULT = "result.json"
say = partial(print, flush=True)
KEPT = 5
"""Inputs that are kept of each way in which the law was broken."""


def find_ourselves() -> None:
    """Make `tests` the folder above: some distribution may have installed a package of that name."""
    package = types.ModuleType("tests")
    package.__path__ = [str(HERE.parent)]
    sys.modules["tests"] = package


class Campaign:
    """The inputs of one parser, until the time is over."""

    def __init__(self, trial: Any, name: str, place: Path, seconds: float) -> None:
        self.trial, self.name, self.place = trial, name, place
        self.began, self.seconds = time.perf_counter(), seconds
        self.inputs = self.values = 0
        self.broken: Counter[str] = Counter()

    def __call__(self, content: bytes) -> None:
        """Try one input."""
        from tests.fuzz.law import Broken
        from tests.fuzz.trial import keep

        self.inputs += 1
        try:
            self.values += self.trial(content) is not None
        except Broken as error:
            kind = "".join(c for c in str(error)[:120] if not c.isdigit())
            self.broken[kind] += 1
            if self.broken[kind] <= KEPT:
                sys.stderr.write(f"{self.name}: {error!s:.600}\n")
                keep(self.name, content, self.place / "found")
        if time.perf_counter() - self.began > self.seconds:
            self.end()

    def end(self) -> NoReturn:
        """Write what there is to count, and leave without libFuzzer's farewell."""
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        facts = {
            "parser": self.name, "inputs": self.inputs, "values": self.values, "broken": sum(self.broken.values()),
            "seconds": time.perf_counter() - self.began, "cpu_s": time.process_time(), "peak_mb": peak,
            "kinds": dict(self.broken),
        }  # fmt: skip
        (self.place / RESULT).write_text(json.dumps(facts), encoding="utf-8")
        shutil.rmtree(self.trial.scratch)
        os._exit(bool(self.broken))


def fuzz(name: str, study: Path, place: Path, seconds: float) -> None:
    """Fuzz one parser in this process, which ends with it."""
    import atheris

    with atheris.instrument_imports(include=["feel321"], enable_loader_override=False):
        from tests.fuzz import trial as trials
    from tests.fuzz.mutations import mutate

    scratch = Path(tempfile.mkdtemp(prefix="fuzz-", dir=trials.MEMORY))
    trial = trials.Trial(name, scratch, study)
    corpus = place / "corpus"
    corpus.mkdir(parents=True)
    for number, content in enumerate(trial.inputs):
        (corpus / f"seed{number}").write_bytes(content[:MOST_BYTES])

    def change(content: bytes, most: int, seed: int) -> bytes:
        rng = random.Random(seed)  # noqa: S311 - libFuzzer's own
        if rng.random() < 1 / 2:
            return bytes(atheris.Mutate(content, most))
        return mutate(rng, content, trial.inputs)[:most]

    options = [
        f"-max_len={MOST_BYTES}", "-len_control=0", "-timeout=30", "-rss_limit_mb=4096", f"-artifact_prefix={place}/",
        "-verbosity=0", "-close_fd_mask=1",
    ]  # fmt: skip
    atheris.Setup(
        ["by_coverage", *options, str(corpus)],
        Campaign(trial, name, place, seconds),
        custom_mutator=change,
    )
    atheris.Fuzz()


def run(name: str, study: Path, out: Path, seconds: float) -> dict[str, Any]:
    """Fuzz one parser in a process of its own, and return what it counted; a crash keeps its input, too."""
    from tests.fuzz.trial import fold, keep

    place = out / fold(name)
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    facts = {"parser": name, "seconds": seconds, "study": study, "out": place}
    words = [
        "--child",
        *(word for key, value in facts.items() for word in (f"--{key}", str(value))),
    ]
    with (place / "said.txt").open("wb") as said:
        code = subprocess.call([sys.executable, __file__, *words], stdout=said, stderr=said)
    for kept in place.glob("found/*/*"):
        keep(name, kept.read_bytes())
    for crash in (*place.glob("crash-*"), *place.glob("oom-*"), *place.glob("timeout-*")):
        keep(name, crash.read_bytes())
    result = place / RESULT
    if not result.is_file():
        tail = (place / "said.txt").read_text(encoding="utf-8", errors="replace")[-500:]
        return {"parser": name, "died": code, "said": tail}
    counted: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
    return counted


HEAD = "| parser | inputs | s | inputs/s | gave a value | peak MB | broke the law |\n|---|---|---|---|---|---|---|"


def format_row(facts: dict[str, Any]) -> str:
    if "died" in facts:
        return f"| {facts['parser']} | died with {facts['died']}: {facts['said']!r} |"
    share, speed = facts["values"] / facts["inputs"], facts["inputs"] / facts["seconds"]
    return (
        f"| {facts['parser']} | {facts['inputs']} | {facts['seconds']:.0f} | {speed:.0f} | {share:.0%} | "
        f"{facts['peak_mb']:.0f} | {facts['broken']} |"
    )


def main(words: Sequence[str] | None = None) -> int:
    """Fuzz the parsers that are named, or all."""
    reader = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    reader.add_argument("--parser", action="append", help="one of them; may be repeated")
    reader.add_argument("--seconds", type=float, default=60.0, help="for each")
    reader.add_argument("--study", type=Path, help="the seed study; made anew by default")
    reader.add_argument("--out", type=Path, help="where results go; a temporary folder by default")
    reader.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = reader.parse_args(words)
    find_ourselves()
    if given.child:
        fuzz(given.parser[0], given.study, given.out, given.seconds)
    from tests.fuzz import seeds
    from tests.fuzz.parsers import PARSERS

    out = given.out or Path(tempfile.mkdtemp(prefix="fuzz-"))
    study = given.study or out / "study"
    if not study.exists():
        seeds.make_study(study)
    say(HEAD)
    results = []
    for name in given.parser or PARSERS:
        results.append(run(name, study, out, given.seconds))
        say(format_row(results[-1]))
    (out / "results.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    inputs = sum(facts.get("inputs", 0) for facts in results)
    say(f"| all | {inputs} | {sum(facts.get('seconds', 0) for facts in results):.0f} |")
    return int(any(facts.get("broken", 1) for facts in results))


if __name__ == "__main__":
    sys.exit(main())
