"""The leaderboard: a folder of cards as one static page, the best first."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from feel321.analysis.report.section import PageTable
from feel321.analysis.tradeoff.benchmark import battery
from feel321.analysis.tradeoff.benchmark.card import Card, read_card
from feel321.analysis.tradeoff.results import PageParts, PageResult
from feel321.doors import as_path
from feel321.types import PathLike

if TYPE_CHECKING:
    from pandas import DataFrame

SUFFIX = ".card.json"
CAPTION = (
    "Methods on battery {version} (digest {digest}), sorted by {by}, the highest first; ties by failed scenes. "
    "In each column the best value is marked with a star."
)
APART = "Cards of battery {version} (digest {digest}): another battery, not comparable with other tables."


class BoardColumn(NamedTuple):
    """A column: where its value is in a card, which way it is better, its format, and what it means.

    best: the function that finds the best value, None where there is no better and worse; missing: what stands where
    there is no value.
    """

    key: str
    head: str
    find: Callable[[Card], float | None]
    best: Callable[..., float] | None
    form: str
    meaning: str
    missing: str = "–"


def _accuracy(measure: str, key: str, part: str = "bundled") -> Callable[[Card], float | None]:
    def find(card: Card) -> float | None:
        rows = getattr(card, part)
        found: float | None = None if rows is None else rows["accuracy"][measure][key]
        return found

    return find


def _stress(measure: str) -> Callable[[Card], float | None]:
    def find(card: Card) -> float | None:
        found: float | None = card.stress[measure]["median"]
        return found

    return find


def _times_1000(value: float | None) -> float | None:
    return None if value is None else 1000 * value


_TURNED = "mean over mountings of the sensor, median over the scenes"
COLUMNS = (
    BoardColumn("bounded", "Bounded spectral match", _accuracy("spectral_match_bounded", "median"), max, ".3f",
                f"How well the spectrum is kept, 0 to 1; {_TURNED}. The table is sorted by it."),
    BoardColumn("bounded_lowest", "its lowest", _accuracy("spectral_match_bounded", "lowest"), max, ".3f",
                "The same in the worst scene and mounting."),
    BoardColumn("segments", "its median in segments", _accuracy("spectral_match_bounded", "segments"), max, ".3f",
                f"The same in segments of {battery.SEGMENT_S:g} s of the output, as mounted: whether the spectrum is "
                "kept at the right moment."),
    BoardColumn("spectral", "Spectral match", _accuracy("spectral_match", "median"), max, ".3f",
                f"The paper's equation 1, at most 1 and without lower bound; {_TURNED}."),
    BoardColumn("temporal", "Temporal match", _accuracy("temporal_match", "median"), max, ".3f",
                f"The paper's equation 2, 0 to 1; {_TURNED}."),
    BoardColumn("mounting_sd", "Mounting SD", _accuracy("temporal_match", "mounting_sd"), min, ".3f",
                "Standard deviation of the temporal match over mountings, median over the scenes."),
    BoardColumn("recordings", "Bounded match, recordings", _accuracy("spectral_match_bounded", "median", "recordings"),
                max, ".3f", "Bounded spectral match on the public recordings, as in the first column.", "not measured"),
    BoardColumn("gain", "Noise gain", lambda card: card.stress["gain"]["worst"], min, ",.1f",
                "How many times more the output changes than the input under sensor noise 60 dB below the signal; the "
                "worst of the stress scenes."),
    BoardColumn("rotation", "Change under rotation", _stress("rotation"), min, ".3f",
                "How much the output itself changes if the sensor is mounted in another way; median over the stress "
                "scenes."),
    BoardColumn("failed", "Failed scenes", lambda card: card.stress["failed_scenes"], min, ".0f",
                "Stress scenes, of 18, in which at least one measure of stability is beyond its limit."),
    BoardColumn("latency", "Look-ahead, ms", lambda card: _times_1000(card.look_ahead_s), min, ".1f",
                "How far the method looks ahead, as measured: the delay that it cannot do without. \"Whole\": it needs "
                "the whole recording.", "whole"),
    BoardColumn("cost", "Cost", lambda card: card.times.relative, min, ".2f",
                "Time, as a multiple of the four Fourier transforms that DFT321 cannot do without, both timed in the "
                "same run."),
    BoardColumn("operations", "Operations", lambda card: card.method.operations, min, ".0f",
                "Operations per sample, as declared.", "unknown"),
    BoardColumn("state", "State", lambda card: card.method.state, min, ".0f",
                "Numbers that it must hold at once, as declared.", "unknown"),
)  # fmt: skip
"""Columns of the leaderboard; the table is sorted by the first."""


def list_figures(card: Card) -> dict[str, Any]:
    """List a card's figures, as the leaderboard's CSV file holds them."""
    facts = {"method": card.name, "battery": card.battery.version, "sha256": card.sha256}
    return facts | {column.key: column.find(card) for column in COLUMNS}


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Leaderboard(PageResult):
    """Cards side by side.

    Parameters
    ----------
    cards : tuple of Card
        All that can be read, the best first; those of this package's battery before others.
    files : tuple of str
        The file of each.
    damaged : tuple of str
        Files that are no card, or damaged, and why; a line each.
    """

    cards: tuple[Card, ...]
    files: tuple[str, ...]
    damaged: tuple[str, ...]

    def to_frames(self) -> dict[str, DataFrame]:
        """Return the figures as a table.

        Returns
        -------
        dict of str to DataFrame
            One table, a row per card.
        """
        import pandas as pd

        rows = [
            {**list_figures(card), "file": file}
            for card, file in zip(self.cards, self.files, strict=True)
        ]
        columns = None if rows else ["method"]
        return {"leaderboard": pd.DataFrame(rows, columns=columns)}

    def _make_page(self, tables: Mapping[str, DataFrame]) -> PageParts:
        boards = list(make_boards(self.cards))
        content = {
            "leaderboard": tables["leaderboard"].to_dict("records"), "damaged": list(self.damaged),
        }  # fmt: skip
        values = {
            "boards": boards, "columns": COLUMNS, "damaged": self.damaged,
            "machines": list(dict.fromkeys(_describe_machine(card) for card in self.cards)),
        }  # fmt: skip
        return PageParts("leaderboard.html", content, (), values)


def read_leaderboard(folder: PathLike) -> Leaderboard:
    """Read every card of a folder; those that are damaged are listed, none is believed."""
    place = as_path(folder, "folder")
    if not place.is_dir():
        raise NotADirectoryError(f"{place}: must be a folder of cards; check the name")
    found, damaged = [], []
    for path in sorted(place.glob(f"*{SUFFIX}")):
        try:
            found.append((read_card(path), path.name))
        except (OSError, ValueError) as error:
            damaged.append(str(error))
    if not found and not damaged:
        raise FileNotFoundError(
            f"{place}: must hold cards (*{SUFFIX}), got none; make some with: feel321 chart --benchmark"
        )
    found.sort(key=lambda one: _order(one[0]))
    cards, files = zip(*found, strict=True) if found else ((), ())
    return Leaderboard(tuple(cards), tuple(files), tuple(damaged))


def _order(card: Card) -> tuple[Any, ...]:
    ours = card.battery.sha256 == battery.bundled_digest()
    value = COLUMNS[0].find(card)
    best = float("inf") if value is None else -float(format(value, COLUMNS[0].form))
    return not ours, _battery_of(card), best, card.stress["failed_scenes"], card.name


def _battery_of(card: Card) -> tuple[str, str]:
    return card.battery.version, card.battery.sha256


def make_boards(cards: Sequence[Card]) -> list[PageTable]:
    """Make a table per battery, that of this package first."""
    boards = []
    for (version, digest), group in groupby(cards, key=_battery_of):
        own, text = list(group), CAPTION if digest == battery.bundled_digest() else APART
        caption = text.format(version=version, digest=digest[:8], by=COLUMNS[0].head.lower())
        columns = [_format_column(column, own) for column in COLUMNS]
        rows = zip([card.name for card in own], *columns, strict=True)
        heads = ("Method", *(column.head for column in COLUMNS))
        boards.append(PageTable(caption, heads, tuple(tuple(row) for row in rows)))
    return boards


def _format_column(column: BoardColumn, cards: Sequence[Card]) -> list[str]:
    """Write a column; the best of two or more values that differ is marked."""
    values = [column.find(card) for card in cards]
    known = {value for value in values if value is not None}
    best = column.best(known) if column.best is not None and len(known) > 1 else None
    cells = []
    for value in values:
        text = column.missing if value is None else format(value, column.form)
        same = best is not None and value is not None and text == format(best, column.form)
        cells.append(f"★ {text}" if same else text)
    return cells


def _describe_machine(card: Card) -> str:
    machine, software = card.times.machine, card.software
    versions = ", ".join(f"{name} {version}" for name, version in software.items())
    return f"{machine.get('processor', 'unknown processor')}; {versions}"


def write_leaderboard(cards: PathLike, folder: PathLike | None = None) -> Path:
    """Write the page of a folder of cards, there or elsewhere, and return its path."""
    return read_leaderboard(cards).write(cards if folder is None else folder)
