"""Every number of every setting has two bounds, and what is beyond them is refused at once."""

import math
import resource
import time
import types
import typing
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from feel321.study.actuator.rig import Rig
from feel321.study.cli import main
from feel321.study.settings import schema
from feel321.study.settings.fields import list_fields, list_tables

UNBOUNDED = {
    "stimuli.gain": "has bounds of its own, and words",
    "reducers.[].operations": "a number or a formula: read by the method",
    "reducers.[].state": "a number or a formula: read by the method",
    "reducers.[].latency": "a number or a formula: read by the method",
}


def list_numbers(
    kind: object, rules: list[object], place: tuple[str, ...], above: frozenset[object]
) -> Iterator[tuple[str, type, list[object]]]:
    """The numbers of a settings table and of those below it, with their rules."""
    if kind in list_tables(kind):
        for name, field in () if kind in above else list_fields(kind).items():
            yield from list_numbers(
                field.annotation, list(field.metadata), (*place, name), above | {kind}
            )
        return
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        own = [
            rule for one in inner[1:] for rule in getattr(one, "metadata", [one])
            if not isinstance(one, FieldInfo) or rule is not None
        ]  # fmt: skip
        yield from list_numbers(inner[0], [*rules, *own], place, above)
    elif kind in {int, float}:
        yield ".".join(place), kind, rules  # type: ignore[misc]  # one of both
    else:
        is_choice = origin in {typing.Union, types.UnionType}
        for one in inner:
            yield from list_numbers(
                one, rules if is_choice else [], place if is_choice else (*place, "[]"), above
            )


NUMBERS = [
    *list_numbers(schema.Settings, [], (), frozenset()),
    *list_numbers(Rig, [], ("rig",), frozenset()),
]


def has(rules: list[object], *names: str) -> bool:
    return any(getattr(rule, name, None) is not None for rule in rules for name in names)


def test_every_number_of_a_setting_has_both_bounds() -> None:
    assert len(NUMBERS) > 100
    bare = {
        place
        for place, _, rules in NUMBERS
        if not (has(rules, "ge", "gt") and has(rules, "le", "lt"))
    }
    assert bare == set(UNBOUNDED)


def test_no_setting_takes_what_is_beyond_all_sense() -> None:
    for _, kind, rules in (one for one in NUMBERS if one[0] not in UNBOUNDED):
        number = TypeAdapter(typing.Annotated[kind, *rules])  # type: ignore[valid-type]  # a type that is found at run time
        for value in (10**20, -(10**20), math.nan, math.inf, -math.inf):
            with pytest.raises(ValidationError):
                number.validate_python(value, strict=kind is float)


TEXT = """
[study]
seed = {seed}
[[recordings]]
scene = "bumps"
rate_hz = {rate_hz}
duration_s = {duration_s}
[stimuli]
reducers = ["sax321", "dft321"]
[session]
repeats = {participants}
[analysis]
draws = {draws}
"""
FINE = {"seed": "1", "rate_hz": "8000.0", "duration_s": "1.0", "draws": "200", "participants": "2"}


@pytest.mark.parametrize("name", FINE)
@pytest.mark.parametrize("value", ["1e12", "nan", "-inf", "9" * 10**6])
def test_a_study_with_a_number_beyond_all_sense_is_refused_at_once(
    name: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "study.toml").write_text(TEXT.format(**{**FINE, name: value}), encoding="utf-8")
    begun, most = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert main(["check", str(tmp_path)]) == 1
    assert time.process_time() - begun < 5
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - most < 50_000
    said = "".join(capsys.readouterr())
    assert max(map(len, said.splitlines())) < 1100


def test_a_scene_that_is_too_large_is_refused_before_it_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = {**FINE, "rate_hz": "1000000.0", "duration_s": "3600.0"}
    (tmp_path / "study.toml").write_text(TEXT.format(**values), encoding="utf-8")
    assert main(["check", str(tmp_path)]) == 1
    assert "promises 3,600,000,000 samples of 3 channels, 3,600 s" in "".join(capsys.readouterr())
