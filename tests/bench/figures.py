"""Figures of the bench: what was promised of them, and what they were when they were last stored."""

from __future__ import annotations

import json
import os
import platform
import re
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

ALLOWED = 1.2
"""How many times as large as stored a ratio may be: machines with other things to do change it by a tenth."""

PACKAGES = ("feel321", "numpy", "scipy", "soxr", "pandas")


@dataclass(frozen=True)
class Figure:
    """One figure.

    limit: the most that is promised, or the least (at_least), None where nothing is. compared: whether it is a ratio
    that the machine's other work does not change.
    """

    what: str
    value: float
    unit: str
    limit: float | None = None
    at_least: bool = False
    compared: bool = True

    @property
    def kept(self) -> bool:
        """Whether the promise was kept; what is no number keeps none."""
        if self.limit is None:
            return True
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def promise(self) -> str:
        """The promise in words."""
        if self.limit is None:
            return ""
        return f"at {'least' if self.at_least else 'most'} {self.limit:g}"

    def grown(self, stored: float) -> float:
        """How many times as bad as stored."""
        return stored / self.value if self.at_least else self.value / stored


def better(first: Figure, second: Figure) -> Figure:
    """Take the better of two measurements of one figure: what disturbs a measurement makes it worse."""
    return max(first, second, key=lambda one: one.value * (1 if one.at_least else -1))


def describe_machine() -> dict[str, Any]:
    """Describe the machine: kind of processor, cores, load, versions."""
    try:
        cpu = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        cpu = ""
    model = re.search(r"^model name\s*:\s*(.*)$", cpu, re.MULTILINE)
    off = os.environ.get("NPY_DISABLE_CPU_FEATURES", "")
    kernel = os.environ.get("OPENBLAS_CORETYPE", "")
    kind = [model[1] if model else platform.processor() or platform.machine()]
    kind += [f"{name} {given}" for name, given in (("without", off), ("as", kernel)) if given]
    return {
        "processor": ", ".join(kind),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
        "versions": {"python": platform.python_version()}
        | {name: version(name) for name in PACKAGES},
    }


def read_history(path: Path) -> list[dict[str, Any]]:
    """Read the stored runs, the oldest first; none if there is no file."""
    if not path.is_file():
        return []
    return [
        _read_run(line, f"{path}, line {number}")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if line.strip()
    ]


def _read_run(line: str, where: str) -> dict[str, Any]:
    try:
        run = json.loads(line)
        stored = {str(what): float(value) for what, value in run["figures"].items()}
        return {
            **run,
            "when": str(run["when"]),
            "processor": str(run["processor"]),
            "figures": stored,
        }
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"{where}: must be one stored run as JSON with when, processor and figures, got {line[:40]!r} "
            f"({type(error).__name__}); correct or delete that line"
        ) from None


def find_stored(history: Sequence[Mapping[str, Any]], processor: str) -> Mapping[str, Any]:
    """Find the newest run on the same kind of processor; empty if there is none."""
    return next((run for run in reversed(history) if run["processor"] == processor), {})


def find_regressions(figures: Iterable[Figure], stored: Mapping[str, Any]) -> Iterator[Figure]:
    """Find the figures that are more than 20 % worse than stored."""
    known = stored.get("figures", {})
    for one in figures:
        if one.compared and one.what in known and not one.grown(known[one.what]) <= ALLOWED:
            yield one  # what is no number, too


def word_regression(figure: Figure, stored: Mapping[str, Any]) -> str:
    """Word a regression in one line."""
    before = stored["figures"][figure.what]
    return (
        f"{figure.what}: {figure.value:.3g} {figure.unit}, {100 * (figure.grown(before) - 1):.0f} % worse than the "
        f"{before:.3g} of {stored['when'][:10]} on this kind of processor; at most {100 * (ALLOWED - 1):.0f} % is "
        "allowed: make it faster, or store it by --accept"
    )


def to_run(figures: Iterable[Figure], machine: Mapping[str, Any], when: str) -> dict[str, Any]:
    """Make the line of history of a run."""
    return {"when": when, **machine, "figures": {one.what: one.value for one in figures}}


def tabulate(
    figures: Iterable[Figure], machine: Mapping[str, Any], stored: Mapping[str, Any], *, when: str
) -> str:
    """Write the table, in Markdown."""
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    lines = [
        f"# Bench of {when[:16]}", "",
        f"{machine['processor']}, {machine['cores']} processors, load {machine['load']:g}; {versions}.", "",
        "| what | value | unit | promised | stored | change | |", "|---|---:|---|---|---:|---:|---|",
    ]  # fmt: skip
    known, figures = stored.get("figures", {}), [*figures]
    worse = {one.what for one in find_regressions(figures, stored)}
    for one in figures:
        before = known.get(one.what)
        cells = (
            ["", ""]
            if not before
            else [f"{before:.3g}", f"{100 * (one.value / before - 1):+.0f} %"]
        )
        mark = "" if one.kept else "MISS"
        mark += " SLOWER" if one.what in worse else ""
        lines.append(
            f"| {one.what} | {one.value:.3g} | {one.unit} | {one.promise} | {cells[0]} | {cells[1]} | {mark.strip()} |"
        )
    return "\n".join(lines) + "\n"
