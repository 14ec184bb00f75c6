"""The bench's comparison with stored runs, on planted histories."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

WHAT, HERE = "dft321, n = 1000", "a processor"


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The bench, which measures nothing: its figures are planted. It is a script, beside its modules."""
    monkeypatch.syspath_prepend(Path(__file__).parent / "bench")
    import bench as module

    machine = {"processor": HERE, "cores": 2, "load": 0.5, "versions": {"numpy": "2"}}
    monkeypatch.setattr(module.figures, "describe_machine", lambda: machine)
    return module


@pytest.fixture
def run(
    bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[int, list[dict[str, Any]]]]:
    """Run the bench with planted values, one per time that the part is measured; exit code and history."""

    def run(
        *values: float, options: tuple[str, ...] = (), **named: Any
    ) -> tuple[int, list[dict[str, Any]]]:
        left = iter(values)

        def measure() -> Iterator[Any]:
            yield bench.figures.Figure(WHAT, next(left), "times four FFTs", **named)

        monkeypatch.setattr(bench, "PARTS", {"single": measure})
        history = tmp_path / "history.jsonl"
        code = bench.main(["--out", str(tmp_path), "--history", str(history), *options])
        assert next(left, None) is None, "measured less often than planted"
        return code, bench.figures.read_history(history)

    return run


def plant(tmp_path: Path, value: float, processor: str = HERE, when: str = "2026-11-01") -> None:
    line = {"when": when, "processor": processor, "figures": {WHAT: value}}
    with (tmp_path / "history.jsonl").open("a") as file:
        file.write(json.dumps(line) + "\n")


def test_an_empty_history_passes_and_stores(run: Any, tmp_path: Path) -> None:
    code, history = run(2.0)
    assert (code, [line["figures"] for line in history]) == (0, [{WHAT: 2.0}])
    assert history[0]["processor"] == HERE
    assert history[0]["versions"] == {"numpy": "2"}
    assert json.loads((tmp_path / "bench.jsonl").read_text()) == history[0]


@pytest.mark.parametrize(("at_least", "value"), [(False, 2.5), (True, 1.6)])
def test_25_per_cent_worse_fails_with_one_line(
    run: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], at_least: bool, value: float
) -> None:
    plant(tmp_path, 1.0, when="2026-10-01")
    plant(tmp_path, 2.0)
    code, history = run(value, value, at_least=at_least)
    (line,) = capsys.readouterr().err.splitlines()
    assert (code, len(history)) == (1, 2)
    assert line.startswith(
        f"{WHAT}: {value:g} times four FFTs, 25 % worse than the 2 of 2026-11-01"
    )
    assert "--accept" in line
    assert "| SLOWER |" in (tmp_path / "bench.md").read_text()


@pytest.mark.parametrize("value", [2.3, 2.0, 0.5])
def test_15_per_cent_worse_or_any_better_passes_and_stores_nothing(
    run: Any, tmp_path: Path, value: float
) -> None:
    plant(tmp_path, 2.0)
    code, history = run(value)
    assert (code, len(history)) == (0, 1)


def test_what_is_worse_once_is_measured_again_and_the_better_counts(
    run: Any, tmp_path: Path
) -> None:
    plant(tmp_path, 2.0)
    assert run(3.0, 2.1)[0] == 0
    assert json.loads((tmp_path / "bench.jsonl").read_text())["figures"] == {WHAT: 2.1}


def test_another_processor_is_not_compared_and_gets_a_line_of_its_own(
    run: Any, tmp_path: Path
) -> None:
    plant(tmp_path, 1.0, processor="another")
    code, history = run(9.0)
    assert (code, [line["processor"] for line in history]) == (0, ["another", HERE])


def test_accept_stores_what_is_worse(run: Any, tmp_path: Path) -> None:
    plant(tmp_path, 2.0)
    code, history = run(9.0, 9.0, options=("--accept",))
    assert (code, [line["figures"][WHAT] for line in history]) == (0, [2.0, 9.0])
    assert run(9.5)[0] == 0


def test_a_part_alone_is_compared_and_not_stored(run: Any, tmp_path: Path) -> None:
    assert run(2.0, options=("--only", "single")) == (0, [])
    plant(tmp_path, 1.0)
    assert run(2.0, 2.0, options=("--only", "single"))[0] == 1
    with pytest.raises(SystemExit):
        run(options=("--only", "single", "--accept"))


def test_a_broken_promise_fails_and_is_not_stored_by_itself(
    run: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    code, history = run(2.0, 2.0, limit=1.5)
    assert (code, history) == (1, [])
    assert capsys.readouterr().err == f"{WHAT}: 2 times four FFTs, promised at most 1.5\n"
    assert run(float("nan"), float("nan"), limit=1.5)[0] == 1
    assert run(2.0, 2.0, limit=1.5, options=("--accept",))[0] == 1


def test_what_other_work_changes_is_not_compared(run: Any, tmp_path: Path) -> None:
    plant(tmp_path, 2.0)
    assert run(9.0, compared=False)[0] == 0
    assert run(float("nan"), float("nan"))[0] == 1  # no number is no better than a worse one


@pytest.mark.parametrize(
    "line",
    ['{"when": "2026', "[]", "7", '{"when": "w", "processor": "p", "figures": {"a": "x"}}', "{}"],
)
def test_a_damaged_line_is_named(
    run: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    plant(tmp_path, 2.0)
    path = tmp_path / "history.jsonl"
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(ValueError, match="line 2"):
        run()
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"{path}, line 2: must be one stored run as JSON")
    assert said.endswith("correct or delete that line")


def test_the_machine_is_described(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent / "bench")
    import figures

    for name in ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES"):
        monkeypatch.delenv(name, raising=False)
    plain = figures.describe_machine()
    assert plain["versions"].keys() >= {"python", "numpy", "scipy", "feel321"}
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")
    assert figures.describe_machine()["processor"] == f"{plain['processor']}, as Prescott"
