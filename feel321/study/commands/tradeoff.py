"""The verb about reducers: tradeoff, in three pages until they are one."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from feel321.jobs import Workers
from feel321.study.commands import shared
from feel321.study.commands.shared import ALONE, Crew, File, Json, Number, Out, Seed, within
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.analysis.tradeoff.advise.scene import Context, Rated
    from feel321.stimuli.guard import OwnReducer
    from feel321.stimuli.recording import Recording

    Ratings = dict[str, dict[str, Rated]]


@dataclass(frozen=True, slots=True)
class TradeoffTask:
    """What reducers are to be compared on, and where the results go."""

    study: StudyFolder
    scenes: bool
    extra: tuple[Path, ...]
    output: Path
    seed: int
    workers: Workers

    def list_own(self) -> "dict[str, OwnReducer]":
        """List the reducers of the lab that the study names, but what was made elsewhere: it reduces nothing else."""
        from feel321.study.methods import list_own_reducers
        from feel321.study.settings.read import read_settings

        if not self.study.settings.is_file():
            return {}
        found = list_own_reducers(read_settings(self.study.settings), self.study.path)
        return {name: one for name, one in found.items() if one.method.origin != "made"}

    def gather(self, *, conditioned: bool = True) -> "tuple[Recording, ...]":
        """Gather the recordings, conditioned or as they came from the sensor."""
        from feel321.study.analyze import gather_recordings

        recordings = gather_recordings(
            self.study.path, scenes=self.scenes, extra=self.extra, conditioned=conditioned
        )
        if conditioned:
            shared.report_warnings(recordings)
        return recordings


def _find_places(places: Sequence[Path], *, scenes: bool) -> tuple[Path | None, tuple[Path, ...]]:
    """Tell the folder of a study from recordings; the current folder is the study where nothing else was named."""
    if not places and not scenes:
        return require_study(Path()).path, ()
    studies = [one for one in places if (one / "study.toml").is_file()]
    extra = tuple(one for one in places if one not in studies)
    if len(studies) > 1:
        shared.refuse_use(f"name one study, got {', '.join(map(str, studies))}")
    for one in extra:
        if not one.exists():
            raise FileNotFoundError(f"{one}: no such study or recording; check the name")
    return (studies[0] if studies else None), extra


def tradeoff(  # noqa: PLR0913 - one per option
    *places: Annotated[File, Parameter(name="STUDY|RECORDING")],
    scenes: bool = False,
    thorough: bool = False,
    online: bool = False,
    latency_ms: Number | None = None,
    mounting: Literal["any", "recorded"] = "any",
    axes: Annotated[int, within(1, 3)] = 1,
    tolerance: Number | None = None,
    out: Out = None,
    seed: Seed = None,
    crew: Crew = ALONE,
    as_json: Json = False,
) -> None:
    """Compare reducers: speed against accuracy, and the simplest that suffices.

    Writes a page of advice (the first reducer, by simplicity, that is as good as the best within tolerance), a chart of
    speed against accuracy, and with --thorough a map of the scenes in which reducers fail, into STUDY/tradeoff. Times
    are measured on this machine: leave it idle.

    Example: feel321 tradeoff my-study
             feel321 tradeoff oak.csv pine.csv --online --latency-ms 45

    Parameters
    ----------
    scenes
        Also the bundled scenes.
    thorough
        Whole recordings, 200 orientations, and difficult scenes; many times as long.
    online
        The reducer runs while the vibration is made.
    latency_ms
        Longest delay online, device included, in ms.  [default: 45]
    mounting
        Mountings of the sensor that advice must hold for.
    axes
        Axes that the actuator can move.
    tolerance
        Largest energy change taken as imperceptible, as a Weber fraction.  [default: 0.22]
    """
    from feel321.analysis.report.folder import check_target
    from feel321.analysis.tradeoff.advise.scene import Context, Tolerance

    with _as_options():
        limits = Tolerance() if tolerance is None else Tolerance(tolerance)
        times = {} if latency_ms is None else {"latency_ms": latency_ms}
        context = Context(online=online, axes=axes, tolerance=limits, mounting=mounting, **times)
    folder, extra = _find_places(places, scenes=scenes)
    output = out or (folder or Path()) / "tradeoff"
    for name in ("advice", "chart", "stress"):
        check_target(output / name)
    # Recordings that were named without a study belong to none, whatever the current folder is.
    study = StudyFolder(folder or output)
    task = TradeoffTask(
        study, scenes, extra, output, _find_seed(study) if seed is None else seed, crew.employ()
    )
    found: dict[str, Any] = {"advice": _advise(task, context, quiet=as_json)}
    found["chart"] = _chart(task, thorough=thorough)
    if thorough:
        found["stress"] = _stress(task)
    if as_json:
        shared.print_json(found)
        return
    for name in found:
        shared.echo(output / name / "index.html")


def _find_seed(study: StudyFolder) -> int:
    from feel321.study.settings.read import read_settings

    return read_settings(study.settings).study.seed if study.settings.is_file() else 0


def _chart(task: TradeoffTask, *, thorough: bool) -> object:
    """Plot the speed of every reducer against its accuracy."""
    from feel321.analysis.tradeoff.chart.compute import FULL, QUICK, compute_chart
    from feel321.study.analyze import find_ratings

    output = task.output / "chart"
    with shared.show_progress("chart") as progress:
        measured = compute_chart(
            task.gather(),
            ratings=find_ratings(task.study),
            own=task.list_own(),
            effort=FULL if thorough else QUICK,
            seed=task.seed,
            workers=task.workers,
            progress=progress,
        )
    with shared.recording(task.study, "tradeoff", output):
        measured.write(output)
    return _read_results(output)


def _stress(task: TradeoffTask) -> object:
    """Find where reducers fail, and which recordings come near."""
    from feel321.analysis.tradeoff.stress.run import stress_reducers
    from feel321.stimuli.reducers.registry import REDUCERS

    sensor = {recording.name: recording for recording in task.gather(conditioned=False)}
    with shared.show_progress("stress") as progress:
        result = stress_reducers(
            task.gather(), {**REDUCERS, **task.list_own()}, sensor=sensor, seed=task.seed,
            workers=task.workers, progress=progress,
        )  # fmt: skip
    result.write(task.output / "stress")
    for name, lines in result.warnings.items():
        for line in lines:
            shared.warn(f"{name}: {line}")
    return _read_results(task.output / "stress")


def _advise(task: TradeoffTask, context: "Context", *, quiet: bool) -> object:
    """Name the simplest sufficient reducer for every recording, by metrics, and by ratings where there are any."""
    from feel321.analysis.tradeoff.advise.page import advise_recordings

    output = task.output / "advice"
    with shared.show_progress("advice") as progress:
        advice = advise_recordings(
            task.gather(),
            context,
            seed=task.seed,
            ratings=_read_ratings(task.study),
            own=task.list_own(),
            workers=task.workers,
            progress=progress,
        )
        with shared.recording(task.study, "tradeoff", output):
            advice.write(output)
    if not quiet:
        shared.echo(advice.summary())
    return _read_results(output)


def _read_results(folder: Path) -> object:
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


_OPTIONS = {
    "--weber": "--tolerance", "--segment_s": "--segment", "_ms must": "-ms must", "set online=True": "add --online",
}  # fmt: skip
"""What messages call an argument -> the option."""


@contextmanager
def _as_options() -> Iterator[None]:
    """Turn what is wrong with an argument into what is wrong with the option of that name."""
    try:
        yield
    except ValueError as error:
        text = f"--{error}"
        for argument, option in _OPTIONS.items():
            text = text.replace(argument, option)
        shared.refuse_use(text)


def _read_ratings(study: StudyFolder) -> "Ratings | None":
    """Read what the ratings say of each reducer, if there are any."""
    from feel321.analysis.tradeoff.advise.scene import judge_ratings
    from feel321.study.analyze import find_ratings
    from feel321.study.settings.read import read_settings

    table = find_ratings(study)
    if table is None:
        return None
    margin = read_settings(study.settings).analysis.margin if study.settings.is_file() else None
    return judge_ratings(table, margin=margin)
