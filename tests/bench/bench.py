"""Speed and memory in one table: `make bench`, with ARGS="--accept" to store it, or --only PART.

Every figure is a ratio measured in one run. The exit code is 1 if a promise was broken, or if a ratio is more than 20 %
worse than in the newest stored run on the same kind of processor. What is broken is measured once more, and the better
figure counts. On a kind of processor without a stored run nothing is compared, and the run is stored.
"""

from __future__ import annotations

import argparse
import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import chain
import delivered
import engine
import figures
import signals
import thresholds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from typing import Any

PARTS: dict[str, Callable[[], Iterator[figures.Figure]]] = {
    "single": signals.measure_single,
    "many": signals.measure_many,
    "streams": signals.measure_streams,
    "memory": signals.measure_memory,
    "build": chain.measure_build,
    "analyze": chain.measure_analyze,
    "engine": engine.measure,
    "thresholds": thresholds.measure,
    "delivered": delivered.measure,
}
ROOT = Path(__file__).resolve().parents[2]


def measure(
    parts: Mapping[str, Callable[[], Iterator[figures.Figure]]], stored: Mapping[str, Any]
) -> list[figures.Figure]:
    """Measure the parts, and once more those in which something is broken."""
    found = []
    for name, work in parts.items():
        own = show(name, work(), stored)
        if any(not one.kept for one in own) or any(figures.find_regressions(own, stored)):
            again = {one.what: one for one in show(f"{name}, again", work(), stored)}
            own = [figures.better(one, again[one.what]) for one in own]
        found += own
    return found


def show(
    name: str, some: Iterator[figures.Figure], stored: Mapping[str, Any]
) -> list[figures.Figure]:
    """Print figures as they come."""
    print(f"-- {name}")
    own = []
    for one in some:
        own.append(one)
        slower = any(figures.find_regressions([one], stored))
        mark = "MISS" if not one.kept else "SLOW" if slower else "ok"
        print(f"{mark:4} {one.what:<48} {one.value:9.3g} {one.unit}  {one.promise}", flush=True)
    return own


def conclude(
    found: Sequence[figures.Figure], stored: Mapping[str, Any]
) -> tuple[list[str], list[str]]:
    """Word broken promises, and ratios that are worse than stored, a line each."""
    missed = [
        f"{one.what}: {one.value:.3g} {one.unit}, promised {one.promise}"
        for one in found
        if not one.kept
    ]
    slower = figures.find_regressions(found, stored)
    return missed, [figures.word_regression(one, stored) for one in slower]


def read_arguments(given: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="make bench", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--accept", action="store_true", help="store this run, whatever it is")
    parser.add_argument(
        "--only", action="append", choices=PARTS, help="measure only this part; nothing is stored"
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT / "build" / "bench", help="folder of the table"
    )
    parser.add_argument("--history", type=Path, default=ROOT / "tests" / "bench" / "history.jsonl",
                        help="the stored runs")  # fmt: skip
    chosen = parser.parse_args(given)
    if chosen.accept and chosen.only:
        parser.error("--accept stores a whole run; leave out --only")
    return chosen


def main(given: Sequence[str] | None = None) -> int:
    """Measure, write the table, compare, and store."""
    chosen = read_arguments(given)
    machine, when = figures.describe_machine(), datetime.now(UTC).isoformat(timespec="seconds")
    try:
        history = figures.read_history(chosen.history)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    stored = figures.find_stored(history, machine["processor"])
    found = measure({name: PARTS[name] for name in chosen.only or PARTS}, stored)
    run = json.dumps(figures.to_run(found, machine, when))
    chosen.out.mkdir(parents=True, exist_ok=True)
    table = figures.tabulate(found, machine, stored, when=when)
    (chosen.out / "bench.md").write_text(table, encoding="utf-8")
    (chosen.out / "bench.jsonl").write_text(run + "\n", encoding="utf-8")
    missed, slower = conclude(found, stored)
    if chosen.accept or not (stored or missed or chosen.only):
        with chosen.history.open("a", encoding="utf-8") as file:
            file.write(run + "\n")
        print(f"stored in {chosen.history}")
        slower = []
    broken = missed + slower
    print(f"{chosen.out / 'bench.md'}: {len(found)} figures, {len(broken)} broken")
    print(*broken, sep="\n", file=sys.stderr, end="\n" if broken else "")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
