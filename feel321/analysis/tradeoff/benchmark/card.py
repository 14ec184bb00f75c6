"""Cards: what the battery found of one method, as JSON; written, and read with distrust.

The same card twice is the same byte for byte but for `times`. A card carries its rows, from which its figures follow,
and a checksum of all but `times`: one that was damaged, cut or edited by hand is refused. Whoever computes a new
checksum for invented rows is found by measuring the method again.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from feel321 import intake
from feel321.analysis.tradeoff.benchmark.measure import summarise_recordings, summarise_stress
from feel321.analysis.tradeoff.chart.points import MEASURES as ACCURACIES
from feel321.files import make_folder, write_text

FORM = "feel321 benchmark card"
LARGEST = 10**7
"""Bytes of a card, at most."""

LOOSE = 4.0

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
AtLeast0 = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Row = dict[str, Any]

_BOUNDED = {name for name in ACCURACIES if name != "spectral_match"}


class _Strict(BaseModel):
    """A part of a card: no other keys, no guessed types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class MethodFacts(_Strict):
    """What a method is and declares of itself; None is unknown."""

    name: Annotated[str, Field(pattern=r"^\S+$", max_length=200)]
    sha256: Sha256 | None
    operations: AtLeast0 | None
    state: AtLeast0 | None
    latency_s: AtLeast0 | None


class BatteryFacts(_Strict):
    """Which battery it was."""

    version: Annotated[str, Field(min_length=1, max_length=20)]
    sha256: Sha256
    recordings_sha256: Sha256 | None


class Times(_Strict):
    """Times of one run, on one machine; relative: to the Fourier transforms that DFT321 cannot do without."""

    relative: Positive
    ns_per_sample: Positive
    low: Positive
    high: Positive
    floor_ns_per_sample: Positive
    block: Row | None
    machine: Row


class Card(_Strict):
    """What the battery found of one method."""

    form: Literal["feel321 benchmark card"]
    method: MethodFacts
    battery: BatteryFacts
    bundled: Row
    recordings: Row | None
    stress: Row
    look_ahead_s: AtLeast0 | None
    software: dict[str, str]
    rows: dict[str, list[Row]]
    sha256: Sha256
    times: Times

    @property
    def name(self) -> str:
        """Name of its method."""
        return self.method.name


def make_card(measured: Mapping[str, Any], times: Mapping[str, Any]) -> Card:
    """Make a card of what was measured: everything but figures, checksum and times."""
    content = {"form": FORM, **measured, **_summarise(measured["rows"])}
    return Card.model_validate({**content, "sha256": _digest(content), "times": times})


def format_card(card: Card) -> str:
    """Write a card as JSON, keys in order."""
    return json.dumps(card.model_dump(), indent=1, sort_keys=True, allow_nan=False) + "\n"


def write_card(card: Card, folder: Path) -> Path:
    """Write a card into a folder, under its method's name."""
    make_folder(folder)
    path = folder / f"{re.sub(r'[^A-Za-z0-9_.-]+', '-', card.name)}.card.json"
    write_text(path, format_card(card))
    return path


def read_card(path: Path) -> Card:
    """Read a card; ValueError, in one line, where it is damaged, forged or none."""
    if path.stat().st_size > LARGEST:
        raise ValueError(f"{path.name}: not a benchmark card: more than {LARGEST} bytes")
    try:
        content = json.loads(intake.read_text(path), parse_constant=_refuse_constant)
        card = Card.model_validate(content)
        _check(card)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "the file"
        raise ValueError(f"{path.name}: not a benchmark card: {place}: {first['msg']}") from None
    except RecursionError:
        raise ValueError(f"{path.name}: not a benchmark card: nested too deeply") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path.name}: not a benchmark card: not UTF-8 text") from None
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{path.name}: not JSON: {error.msg} in line {error.lineno}; was it copied whole?"
        ) from None
    except (ValueError, ArithmeticError, TypeError, KeyError, AttributeError) as error:
        text = str(error) if isinstance(error, ValueError) else f"its rows are damaged ({error!r})"
        raise ValueError(f"{path.name}: {text}; measure the method again") from None
    return card


def _refuse_constant(name: str) -> float:
    raise ValueError(f"a card holds no {name}")


def _summarise(rows: Mapping[str, list[Row]]) -> dict[str, Any]:
    return {
        "bundled": summarise_recordings(rows["scenes"]),
        "recordings": summarise_recordings(rows["recordings"]),
        "stress": summarise_stress(rows["stress"]),
    }


def _digest(content: Mapping[str, Any]) -> str:
    kept = {key: value for key, value in content.items() if key not in {"sha256", "times"}}
    text = json.dumps(kept, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _check(card: Card) -> None:
    """Refuse a card whose figures are not those of its rows, or cannot be."""
    content = card.model_dump()
    if _digest(content) != card.sha256:
        raise ValueError("its checksum is not that of its content: it was changed or damaged")
    if set(card.rows) != {"scenes", "recordings", "stress"}:
        raise ValueError(f"rows must be of scenes, recordings and stress, got {sorted(card.rows)}")
    for part, figures in _summarise(card.rows).items():
        if content[part] != figures:
            raise ValueError(f"the figures under {part!r} do not follow from its rows")
    if bool(card.rows["recordings"]) != (card.battery.recordings_sha256 is not None):
        raise ValueError("rows and digest of the recordings do not go together")
    for row in [*card.rows["scenes"], *card.rows["recordings"]]:
        _check_row(row)
    ratio = card.times.relative * card.times.floor_ns_per_sample / card.times.ns_per_sample
    if not 1 / LOOSE <= ratio <= LOOSE:  # medians of a ratio and of its terms differ
        raise ValueError("its cost is not its time over that of the transforms")


def _check_row(row: Row) -> None:
    """Refuse values that no method can have."""
    for measure in ACCURACIES:
        for key, value in row[measure].items():
            bounded = measure in _BOUNDED or key == "sd"
            low, high = 0 if bounded else -math.inf, math.inf if key == "sd" else 1
            if value is not None and not low <= value <= high:
                raise ValueError(f"{row['recording']}: {measure} cannot be {value:g} ({key})")
    if row["gain"] is not None and row["gain"] < 0:
        raise ValueError(f"{row['recording']}: a gain cannot be {row['gain']:g}")
