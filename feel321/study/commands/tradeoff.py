"""The verb about reducers: tradeoff."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import ALONE, Crew, File, Json, Number, Out, Seed
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.analysis.tradeoff.judge import Context
    from feel321.analysis.tradeoff.page import Tradeoff
    from feel321.jobs import Workers
    from feel321.study.settings.schema import Settings
    from feel321.types import Metric, Reducer


def tradeoff(  # noqa: PLR0913 - one per option
    *places: Annotated[File, Parameter(name="[STUDY | RECORDING...]")],
    scenes: bool = False,
    thorough: bool = False,
    online: bool = False,
    latency_ms: Number | None = None,
    mounting: Literal["any", "recorded"] = "any",
    tolerance_db: Number | None = None,
    out: Out = None,
    seed: Seed = None,
    crew: Crew = ALONE,
    as_json: Json = False,
) -> None:
    """Compare reducers: speed, accuracy, where they fail, and the simplest that suffices.

    Writes one page into STUDY/tradeoff. Times are measured on this machine: leave it idle.

    Example: feel321 tradeoff my-study
             feel321 tradeoff oak.csv pine.csv --online --latency-ms 45

    Parameters
    ----------
    scenes
        Also the bundled scenes.
    thorough
        Whole recordings, 72 mountings, and difficult scenes; many times as long.
    online
        The reducer runs while the vibration is made.
    latency_ms
        Longest delay online, device included, in ms.  [default: 45]
    mounting
        Mountings of the sensor that advice must hold for.
    tolerance_db
        How far from the best is as good, in dB of energy.  [default: 1]
    """
    from feel321.analysis.report.folder import check_target
    from feel321.analysis.tradeoff.judge import TOLERANCE_DB, Context

    folder, extra = _find_places(places, scenes=scenes)
    try:
        tolerance = TOLERANCE_DB if tolerance_db is None else tolerance_db
        context = Context(online, latency_ms, mounting, tolerance)
    except ValueError as error:
        text = f"--{error}".replace("set online=True", "add --online")
        for name in ("latency_ms", "tolerance_db"):
            text = text.replace(name, name.replace("_", "-"))
        shared.refuse_use(text)
    output = out or (folder or Path()) / "tradeoff"
    check_target(output)
    # Recordings that were named without a study belong to none, whatever the current folder is.
    study = StudyFolder(folder or output)
    with shared.show_progress("tradeoff") as progress:
        result = _compare(
            study, context, scenes=scenes, extra=extra, thorough=thorough, seed=seed,
            workers=crew.employ(), progress=progress,
        )  # fmt: skip
    with shared.recording(study, "tradeoff", output):
        result.write(output)
    if not as_json:
        shared.echo(result.summary())
    shared.print_results(output, as_json=as_json)


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


def _compare(  # noqa: PLR0913 - one per choice
    study: StudyFolder,
    context: "Context",
    *,
    scenes: bool,
    extra: tuple[Path, ...],
    thorough: bool,
    seed: int | None,
    workers: "Workers",
    progress: Callable[[int, int], None],
) -> "Tradeoff":
    """Gather recordings, the lab's own methods and ratings; measure, and judge."""
    from feel321.analysis.tradeoff.judge import WINDOWS_MS
    from feel321.analysis.tradeoff.measure import measure_tradeoff
    from feel321.analysis.tradeoff.page import advise_tradeoff
    from feel321.stimuli.reducers.registry import REDUCERS
    from feel321.study.analyze import find_ratings, gather_recordings
    from feel321.study.settings.read import read_settings

    recordings = gather_recordings(study.path, scenes=scenes, extra=extra)
    shared.report_warnings(recordings)
    settings = read_settings(study.settings) if study.settings.is_file() else None
    reducers, metrics = _list_methods(settings, study.path)
    frame = measure_tradeoff(
        recordings,
        reducers=dict(REDUCERS) | reducers,
        metrics=metrics,
        windows_ms=[one for one in WINDOWS_MS if one <= context.room_ms] if context.online else (),
        thorough=thorough,
        rng=(settings.study.seed if settings else 0) if seed is None else seed,
        workers=workers,
        progress=progress,
    )
    return advise_tradeoff(
        frame,
        context,
        ratings=find_ratings(study),
        margin=settings.analysis.margin if settings else None,
    )


def _list_methods(
    settings: "Settings | None", folder: Path
) -> "tuple[dict[str, Reducer], dict[str, Metric]]":
    """List the lab's own reducers, but those made elsewhere, which reduce nothing else; and metrics beside ours."""
    from feel321.names import WRITTEN
    from feel321.stimuli.guard import OwnMetric
    from feel321.stimuli.metrics import METRICS
    from feel321.study.methods import list_methods, list_own_reducers

    if settings is None:
        return {}, {}
    own = list_own_reducers(settings, folder)
    reducers: dict[str, Reducer] = {
        name: one for name, one in own.items() if one.method.origin != "made"
    }
    asked = [name for name in settings.stimuli.metrics if name in METRICS and name not in WRITTEN]
    metrics = {name: METRICS[name] for name in asked}
    methods = list_methods(settings, folder)
    return reducers, metrics | {one.name: OwnMetric(one) for one in methods if one.kind == "metric"}
