"""The benchmark: a fixed battery, cards that come out the same again, a leaderboard that believes no forged one."""

from __future__ import annotations

import copy
import hashlib
import json
import re
import shutil
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321 import analysis
from feel321.analysis.tradeoff.benchmark import battery, card, leaderboard, run
from feel321.analysis.tradeoff.benchmark.measure import measure_look_ahead
from feel321.analysis.tradeoff.chart.accuracy import ReducerVariant, measure_accuracy
from feel321.analysis.tradeoff.chart.points import MEASURES
from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING, StreamingReducer
from feel321.study.cli import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

DIGEST = "aa04223afe170e368ceadf54027ee36e710ef2955097233214ec569d0212ad39"
"""Of battery 1. Where it changes the battery has changed: then cards cannot be compared, and VERSION must change."""


def twice(acceleration: Any, rate_hz: float) -> Any:
    return 2 * REDUCERS.dft321(acceleration, rate_hz)


def dice(acceleration: Any, _rate_hz: float) -> Any:
    return np.random.default_rng().standard_normal(acceleration.shape[-1])


def cut(acceleration: Any, _rate_hz: float) -> Any:
    return acceleration[0][1:]


def stumble(_acceleration: Any, _rate_hz: float) -> Any:
    raise LookupError("no\nsuch thing")


def overwrite(acceleration: Any, _rate_hz: float) -> Any:
    acceleration[0] = 0.0
    return acceleration[1]


GOOD: dict[str, Any] = {name: REDUCERS[name] for name in ("dft321", "mag321", "pca321_adaptive")}
BAD = {"dice": dice, "cut": cut, "stumble": stumble, "overwrite": overwrite}


@pytest.fixture(scope="module")
def result() -> run.Benchmark:
    return run.run_benchmark({**GOOD, "twice": twice, **BAD}, rounds=3)


@pytest.fixture
def cards(result: run.Benchmark, tmp_path: Path) -> Path:
    result.write(tmp_path)
    return tmp_path


def test_the_battery_is_the_one_that_its_version_names() -> None:
    assert (battery.VERSION, battery.bundled_digest()) == ("1", DIGEST)


def test_a_digest_sees_a_changed_sample_and_no_last_bit() -> None:
    one = battery.make_battery().scenes[0]
    samples = one.acceleration.copy()
    noise = np.random.default_rng(0).standard_normal(samples.shape)
    same = type(one)(samples * (1 + 1e-14 * noise), one.rate_hz, one.name)
    samples[1, 100:110] *= 1.5
    other = type(one)(samples, one.rate_hz, one.name)
    assert battery.digest([one]) == battery.digest([same]) != battery.digest([other])


def test_a_card_is_the_same_again_but_for_its_times(result: run.Benchmark, tmp_path: Path) -> None:
    again = run.run_benchmark({"mag321": REDUCERS.mag321, "dft321": REDUCERS.dft321}, rounds=3)
    for one in again.cards:
        first = next(each for each in result.cards if each.name == one.name)
        texts = []
        for each in (first, one):
            content = json.loads(card.write_card(each, tmp_path).read_text(encoding="utf-8"))
            assert content.pop("times")["relative"] > 0
            texts.append(json.dumps(content))
        assert texts[0] == texts[1]


def test_figures_are_those_of_chart_and_stress(result: run.Benchmark) -> None:
    made = battery.make_battery()
    for one in result.cards[:3]:
        rows = measure_accuracy(made.scenes[2], [ReducerVariant(one.name)], turns=made.turns)
        known = {row["measure"]: row["mean"] for row in rows}
        for measure in MEASURES:
            assert one.rows["scenes"][2][measure]["mean"] == pytest.approx(
                known[measure], rel=1e-5, abs=1e-8
            )
    by_name = {one.name: one for one in result.cards}
    # Equation 3 keeps every magnitude, so DFT321 scores 1 in every mounting; twice as strong is 6 dB too strong.
    spectral = by_name["dft321"].bundled["accuracy"]["spectral_match"]
    assert spectral["median"] == spectral["lowest"] == pytest.approx(1.0)
    assert spectral["mounting_sd"] == pytest.approx(0.0, abs=1e-8)
    assert by_name["twice"].stress["energy"]["median"] == pytest.approx(20 * np.log10(2), abs=0.01)
    # The length of a vector does not know how the sensor is mounted.
    assert by_name["mag321"].stress["rotation"]["worst"] == 0.0
    assert by_name["pca321_adaptive"].method.operations == 59.0  # as in the table of resources
    assert by_name["twice"].method.operations is None


@pytest.mark.parametrize("name", [name for name in REDUCERS if name not in WHY_NOT_STREAMING])
def test_what_streams_looks_no_further_ahead_than_its_latency(name: str) -> None:
    latency = StreamingReducer(name, 4000).latency_samples / 4000
    ahead = measure_look_ahead(REDUCERS[name])
    assert ahead is not None
    assert latency - 0.005 <= ahead <= latency


def test_looking_ahead_is_found_out() -> None:
    def peek(acceleration: Any, _rate_hz: float) -> Any:
        return np.roll(acceleration[..., 0, :], -50, axis=-1)

    assert measure_look_ahead(peek) == 50 / 4000
    assert measure_look_ahead(REDUCERS.dft321) is None
    assert measure_look_ahead(REDUCERS.pca321_matched) is None


def test_a_method_that_fails_costs_its_own_card_only(result: run.Benchmark) -> None:
    assert [one.name for one in result.cards] == [*GOOD, "twice"]
    found = dict(line.split(": ", 1) for line in result.failures)
    assert list(found) == [*BAD]
    assert "differ by up to" in found["dice"]
    assert "of shape (20000,), got float64 of shape (19999,)" in found["cut"]
    assert re.search(r"LookupError: .*such thing.*test_cards\.py, line \d+", found["stumble"])
    assert "changed its input" in found["overwrite"]
    assert not any("\n" in line for line in result.failures)


def test_a_name_that_is_taken_is_refused() -> None:
    with pytest.raises(ValueError, match="names of their own, got 'dft321' twice"):
        analysis.benchmark({"dft321": twice})


def test_a_folder_without_the_public_recordings_is_refused(tmp_path: Path) -> None:
    (tmp_path / "knocks_26k.wav").write_bytes(b"RIFF")
    with pytest.raises(ValueError, match=r"11 public recordings .*is missing.*and 8 more; docs"):
        battery.make_battery(tmp_path)


def test_the_public_recordings_are_known_by_digest(shared_recordings: Path) -> None:
    for public in battery.PUBLIC:
        content = (shared_recordings / public.file).read_bytes()
        assert hashlib.sha256(content).hexdigest() == public.sha256
        assert public.licence in {"MIT", "BSD-3-Clause"}
    made = run.run_benchmark({"dft321": REDUCERS.dft321}, folder=shared_recordings, rounds=3).cards[
        0
    ]
    assert made.recordings is not None
    assert len(made.rows["recordings"]) == len(battery.PUBLIC)
    assert made.recordings["accuracy"]["spectral_match"]["lowest"] == pytest.approx(1.0)


def change(content: dict[str, Any], *path: str | int, value: object) -> None:
    place: Any = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value


def sign(content: dict[str, Any]) -> None:
    """Give a forged card the checksum that it needs."""
    content["sha256"] = card._digest(content)


def better(content: dict[str, Any]) -> None:
    change(content, "bundled", "accuracy", "spectral_match_bounded", "median", value=0.9999)
    sign(content)


def impossible(content: dict[str, Any]) -> None:
    for row in content["rows"]["scenes"]:
        row["spectral_match_bounded"]["mean"] = 1.2
    content.update(card._summarise(content["rows"]))
    sign(content)


FORGERIES: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "edited": (lambda c: change(c, "look_ahead_s", value=0.0), "checksum"),
    "row edited": (
        lambda c: change(c, "rows", "scenes", 0, "gain", value=0.5), "checksum"),
    "figures": (better, "'bundled' do not follow from its rows"),
    "impossible": (impossible, "spectral_match_bounded cannot be 1.2"),
    "missing": (lambda c: c.pop("battery"), "battery: Field required"),
    "extra": (lambda c: change(c, "award", value="gold"), "award: Extra inputs"),
    "type": (lambda c: change(c, "times", "relative", value="fast"), "times.relative: Input should be"),
    "negative": (lambda c: change(c, "times", "relative", value=-1.0), "times.relative"),
    "cost": (lambda c: change(c, "times", "relative", value=1e-6), "cost is not its time"),
    "rows": (lambda c: (change(c, "rows", "scenes", value=[{"x": 1}]), sign(c)), "rows are damaged"),
    "no rows": (lambda c: (change(c, "rows", value={}), sign(c)), "rows must be of scenes"),
}  # fmt: skip


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forged_card_is_one_clear_line(cards: Path, name: str) -> None:
    path = cards / "dft321.card.json"
    forge, message = FORGERIES[name]
    content = json.loads(path.read_text(encoding="utf-8"))
    forge(content)
    path.write_text(json.dumps(content), encoding="utf-8")
    board = leaderboard.read_leaderboard(cards)
    assert "dft321" not in [one.name for one in board.cards]
    assert len(board.damaged) == 1
    assert board.damaged[0].startswith("dft321.card.json: ")
    assert message in board.damaged[0]
    assert "\n" not in board.damaged[0]


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[1]", b"\xff\xfe", b'{"a": NaN}', b"[" * 100_000, b"null"]
)
def test_a_damaged_file_is_one_clear_line(cards: Path, content: bytes) -> None:
    (cards / "dft321.card.json").write_bytes(content)
    (line,) = leaderboard.read_leaderboard(cards).damaged
    assert line.startswith("dft321.card.json: ")
    assert "\n" not in line


def test_the_leaderboard(cards: Path) -> None:
    other = json.loads((cards / "mag321.card.json").read_text(encoding="utf-8"))
    change(other, "battery", "version", value="0")
    change(other, "battery", "sha256", value="0" * 64)
    change(other, "method", "name", value="<b>old</b>")
    sign(other)
    (cards / "old.card.json").write_text(json.dumps(other), encoding="utf-8")
    (cards / "broken.card.json").write_text("{", encoding="utf-8")
    page = leaderboard.write_leaderboard(cards).read_text(encoding="utf-8")
    ours, apart = re.findall(r"<table>.*?</table>", page, flags=re.DOTALL)
    names = re.findall(r'<th scope="row">(.*?)</th>', ours)
    assert names[0] == "dft321"
    assert sorted(names) == ["dft321", "mag321", "pca321_adaptive", "twice"]
    values = [float(text) for text in re.findall(r"</th><td>(?:★ )?([\d.]+)<", ours)]
    assert values == sorted(values, reverse=True)
    assert "★ 1.000" in ours
    assert re.findall(r'<th scope="row">(.*?)</th>', apart) == ["&lt;b&gt;old&lt;/b&gt;"]
    assert "another battery" in apart
    assert "broken.card.json: not JSON" in page
    for column in leaderboard.COLUMNS:
        assert f'scope="col">{column.head}</th>' in page
        assert f"<dt>{column.head}</dt><dd>" in page
    table = (cards / "tables" / "leaderboard.csv").read_text(encoding="utf-8")
    assert table.count("\n") == 6
    # A page is made again over itself, and a second time says the same.
    assert leaderboard.write_leaderboard(cards).read_text(encoding="utf-8") == page


def test_the_verb(
    cards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def pretend(methods: dict[str, Any], **given: Any) -> run.Benchmark:
        assert [*methods] == ["mag321"]
        assert given["folder"] is None
        return run.Benchmark((leaderboard.read_card(cards / "mag321.card.json"),), ("x: fails",))

    monkeypatch.setattr(run, "run_benchmark", pretend)
    made = tmp_path / "made"
    assert main(["chart", "--benchmark", "--method", "mag321", "--out", str(made)]) == 1
    assert capsys.readouterr().err == "feel321: x: fails\n"
    assert [path.name for path in made.iterdir()] == ["mag321.card.json"]
    shutil.copy(made / "mag321.card.json", made / "copy.card.json")
    (made / "bad.card.json").write_text("{", encoding="utf-8")
    assert main(["chart", "--leaderboard", str(made)]) == 0
    printed = capsys.readouterr()
    assert printed.out.strip() == str(made / "index.html")
    assert "warning: bad.card.json: not JSON" in printed.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--method", "mag321"], "requires --benchmark"),
        (["--benchmark", "--scenes"], "the battery is fixed"),
        (["--benchmark", "--leaderboard", "."], "make the cards first"),
        (["--leaderboard", "nowhere"], "must be a folder of cards"),
        (["--leaderboard", "."], r"must hold cards (*.card.json), got none"),
        (["--benchmark", "--method", "dft312"], "did you mean 'dft321'"),
    ],
)
def test_the_verb_refuses(
    words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["chart", *words]) in {1, 2}
    assert message in capsys.readouterr().err


def test_a_copy_is_not_the_card_it_was_made_of(result: run.Benchmark) -> None:
    content = copy.deepcopy(result.cards[0].model_dump())
    assert card._digest(content) == content["sha256"]
    content["times"]["relative"] = 5.0
    assert card._digest(content) == content["sha256"]
