"""The tables of `study.toml` on what participants do: `[session]`, `[tasks]` and `[between]`."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from protocols.design import ORDERS
from protocols.flow import FLAGS
from protocols.registry import PROTOCOLS
from protocols.texts import list_languages
from study.session.opening import POLICIES
from study.settings.factors import check_factor, check_groups
from study.settings.fields import (
    Count,
    Distinct,
    NotNegative,
    OrOff,
    Positive,
    Share,
    Some,
    Table,
    Words,
    one_of,
)

LANGUAGE_FILE = ".toml"
"""How the name of a lab's own file of texts ends."""


def _check_language(language: str) -> str:
    if language not in list_languages() and not language.endswith(LANGUAGE_FILE):
        raise ValueError(f'allowed: {", ".join(list_languages())}, or a file beside study.toml such as "texts/fr.toml"')
    return language


class RehearsalTable(Table):
    """`[session.rehearsal]`: what comes before the trials that count."""

    training: Annotated[Count, Field(le=100)] = 4
    practice: Annotated[Count, Field(le=100)] = 2
    pass_share: Share = 0.75
    rounds: Annotated[int, Field(ge=1, le=100)] = 3


class BreaksTable(Table):
    """`[session.breaks]`: when the hand rests."""

    every_trials: Annotated[Annotated[int, Field(ge=1)] | None, OrOff] = 60
    every_min: Annotated[Annotated[Positive, Field(le=1440)] | None, OrOff] = 10.0
    break_s: Annotated[NotNegative, Field(le=3600)] = 30.0
    rest_s: Annotated[NotNegative, Field(le=3600)] = 60.0


class QualityTable(Table):
    """`[session.quality]`: which trials are tried again."""

    min_response_s: Annotated[NotNegative, Field(le=5)] = 0.2
    max_attempts: Annotated[int, Field(ge=1, le=100)] = 3
    reject: Annotated[tuple[Annotated[str, one_of(FLAGS)], ...], Distinct] = (
        "underrun",
        "device_error",
        "too_fast",
        "not_felt",
    )
    gap_s: Annotated[NotNegative, Field(le=30)] = 0.5


class StaleTable(Table):
    """`[session.stale]`: what becomes of a session that is resumed late."""

    after_h: Annotated[Annotated[Positive, Field(le=8760)] | None, OrOff] = 6.0
    policy: Annotated[str, one_of(POLICIES)] = "warm_up"


class SessionTable(Table):
    """`[session]`: what participants do."""

    protocols: Annotated[tuple[Annotated[str, one_of(PROTOCOLS)], ...], Some] = ("realism", "similarity")
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    order: Annotated[str, one_of(ORDERS)] = "williams"
    language: Annotated[str, AfterValidator(_check_language)] = "en"
    consent: Words | None = None
    rehearsal: RehearsalTable = RehearsalTable()
    breaks: BreaksTable = BreaksTable()
    quality: QualityTable = QualityTable()
    stale: StaleTable = StaleTable()


class TaskTable(Table):
    """`[tasks.NAME]`: how a protocol is used; what is left out is as the protocol has it."""

    timing: Words | None = None
    reference: Words | None = None
    surface: bool = False


Tasks = dict[Annotated[str, one_of(PROTOCOLS)], TaskTable]
Between = Annotated[
    dict[Annotated[str, AfterValidator(check_factor)], Annotated[tuple[Words, ...], Some]], AfterValidator(check_groups)
]
