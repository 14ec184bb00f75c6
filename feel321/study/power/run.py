"""Plan a study: power of a grid of designs, and whole studies as its check."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from feel321.analysis.power import plan as planning
from feel321.analysis.power import simulate
from feel321.doors import announce, check_name
from feel321.study.observer.participant import SPECTRAL
from feel321.study.power import page, setup, whole

if TYPE_CHECKING:
    from feel321.analysis.power.design import Power, PowerDesign
    from feel321.jobs import Workers
    from feel321.study.power.setup import PowerTask

    Progress = Callable[[int, int], None]

KEPT = ".studies"
"""Folder, in that of the results, of simulated studies: an interrupted call is continued from there."""

PEOPLE = (6, 8, 12, 16, 20, 24, 32, 40)
REPEATS = (1, 2, 3)
LEAST_RECORDINGS, LEAST_REDUCERS = 4, 3


@dataclass(frozen=True, slots=True)
class Choices:
    """Which designs are compared, where nothing is said around the study's own, and how well.

    hypothesis: attribute/metric; whole: number of whole studies.
    """

    participants: Sequence[int] = ()
    recordings: Sequence[int] = ()
    reducers: Sequence[int] = ()
    repeats: Sequence[int] = ()
    hypothesis: str = ""
    wanted: float = 0.8
    studies: int = 1000
    whole: int = 0
    seed: int = 0

    def choose_sizes(self, task: PowerTask) -> dict[str, tuple[int, ...]]:
        """Choose the numbers that are compared; participants are those who rate each attribute."""
        own = task.design
        people = self.participants or tuple(task.share * number for number in PEOPLE)
        if odd := [number for number in people if number % task.share]:
            raise ValueError(
                f"participants must be multiples of {task.share}, the groups of [between] that rate different things; "
                f"got {odd[0]}"
            )
        half, more = max(own.recordings // 2, LEAST_RECORDINGS), -(-3 * own.recordings // 2)
        fewer = max(2 * own.reducers // 3, LEAST_REDUCERS)
        return {
            "participants": tuple(number // task.share for number in people),
            "recordings": tuple(self.recordings) or _sort(half, own.recordings, more, 2 * own.recordings),
            "reducers": tuple(self.reducers) or _sort(fewer, own.reducers, 2 * own.reducers - fewer),
            "repeats": tuple(self.repeats) or _sort(*REPEATS, own.repeats),
        }  # fmt: skip


def _sort(*numbers: int) -> tuple[int, ...]:
    return tuple(sorted(set(numbers)))


def plan_study(
    task: PowerTask,
    choices: Choices,
    *,
    keep: Path,
    workers: Workers,
    progress: Progress = lambda _done, _all: None,
) -> page.StudyPower:
    """Compute the power of all designs, and run whole studies where they are asked for."""
    sizes = choices.choose_sizes(task)
    near = min(sizes["participants"], key=lambda number: abs(number - task.design.participants))
    design = task.design.change(participants=near)
    keep.mkdir(parents=True, exist_ok=True)
    plan = planning.plan_power(
        design, task.truth, **sizes, hypothesis=_find_hypothesis(task, choices.hypothesis), wanted=choices.wanted,
        studies=choices.studies, seed=choices.seed, minutes=task.find_minutes, workers=workers, keep=keep,
        progress=progress,
    )  # fmt: skip
    found = page.StudyPower(
        plan,
        task.paper.settings.study.name,
        tabulate_effects(task),
        task.share,
        pd.DataFrame(),
        tuple(_list_notes(task)),
    )
    if not choices.whole:
        return found
    announce(f"{choices.whole} whole studies")
    checked = check_whole(
        task, found.shown.design, choices, keep=keep, workers=workers, progress=progress
    )
    return replace(found, whole=checked)


def _find_hypothesis(task: PowerTask, name: str) -> tuple[str, str] | None:
    if not name:
        return None
    known = {
        f"{attribute}/{metric}": (attribute, metric) for attribute, metric in task.design.hypotheses
    }
    return known[check_name(name, known, "hypothesis")]


def tabulate_effects(task: PowerTask) -> pd.DataFrame:
    """List what is planted, a row per hypothesis."""
    effects, rows = task.effects, []
    for (attribute, metric), slope in zip(
        task.design.hypotheses, effects.to_slopes().values(), strict=True
    ):
        step, said = effects.steps[metric], {metric, f"{attribute}/{metric}"} & set(effects.given)
        rows.append({
            "attribute": attribute, "metric": metric, "points": slope * step.size, "per": step.per, "size": step.size,
            "source": "given" if said else "simulated observers",
        })  # fmt: skip
    return pd.DataFrame(rows)


def _list_notes(task: PowerTask) -> list[str]:
    notes = list(task.notes)
    if task.share > 1:
        notes.append(
            f"Each attribute is rated by one in {task.share} participants, as [between] says."
        )
    if len(task.effects.given) < len(task.effects.steps):
        notes.append(
            "Slopes without --effect are those that the simulated observers of study.toml feel: give the smallest "
            "slope that would matter to you."
        )
    pace = task.pace.participants
    who = f"{pace} participants so far" if pace else "simulated participants"
    return [*notes, f"Minutes are those of one session, at the pace of {who}."]


# Whole studies, and the fast simulation of the same observers beside them.


def check_whole(
    task: PowerTask,
    shown: PowerDesign,
    choices: Choices,
    *,
    keep: Path,
    workers: Workers,
    progress: Progress,
) -> pd.DataFrame:
    """Compare whole studies with the fast simulation of the same observers: a row per hypothesis.

    The study has its own recordings and reducers, and as many participants and repeats as the design that is shown.
    """
    paper = _plant_observers(task, shown)
    design = task.design.change(participants=shown.participants, repeats=shown.repeats)
    wholes = whole.run_wholes(
        paper, choices.whole, seed=choices.seed, workers=workers, keep=keep, progress=progress
    )
    rated, points, steps = setup.split_expected(paper)
    effects = setup.Effects(points, steps)
    truth = setup.fit_truths(
        setup.split_observers(paper, task.share), {"slopes": effects.to_slopes()}
    )
    truth = replace(truth, bounded=False, source=f"{setup.SAMPLE} simulated observers")
    fast = simulate.find_power(
        design,
        truth,
        studies=max(choices.studies, 1),
        seed=choices.seed,
        workers=workers,
        keep=keep,
    )
    return compare_whole(
        wholes, fast, {part.lead: name for part, name in zip(rated, points.index, strict=True)}
    )


def _plant_observers(task: PowerTask, shown: PowerDesign) -> whole.PaperStudy:
    """Plan the study for observers who feel the planted slopes."""
    paper, effects = task.paper, task.effects
    settings = paper.settings
    spectral = next((name for name in effects.steps if name in SPECTRAL), SPECTRAL[0])
    felt = {spectral: "spectral", "temporal_match": "temporal"}
    if strange := [name for name in effects.given if name not in felt]:
        raise ValueError(
            f"--full plants slopes in simulated observers, who feel {' and '.join(felt)} on every scale alike; got "
            f"--effect {strange[0]}; leave out --full"
        )
    slopes = {
        felt[name]: float(effects.points[name].iloc[0]) / effects.steps[name].size
        for name in effects.given
    }
    settings = settings.model_copy(update={
        "observer": settings.observer.model_copy(update=slopes),
        "session": settings.session.model_copy(update={"repeats": shown.repeats}),
    })  # fmt: skip
    return whole.PaperStudy.draw(
        settings,
        paper.folder,
        paper.stimuli,
        participants=shown.participants * task.share,
        further=paper.further,
        screening=paper.screening,
    )


def compare_whole(wholes: whole.Wholes, fast: Power, names: dict[str, str]) -> pd.DataFrame:
    """Put whole studies beside the fast simulation and the closed form.

    names: what the report calls an attribute -> what the design calls it.
    """
    slopes = wholes.slopes.assign(attribute=wholes.slopes["part"].map(names))
    rows = []
    for row in fast.table.to_dict("records"):
        own = slopes[
            (slopes["attribute"] == row["attribute"]) & (slopes["metric"] == row["metric"])
        ]
        own = own[own["estimable"].astype(bool)]
        found = int((own["p_holm"] < LEVEL).sum())
        held = int(((own["low"] <= row["slope"]) & (own["high"] >= row["slope"])).sum())
        rows.append({
            "attribute": row["attribute"], "metric": row["metric"], "slope": row["slope"], "studies": wholes.studies,
            "tests": len(own), "failed": len(wholes.failed), "screened": wholes.screened,
            **_share("whole", found, len(own)), "fast": row["simulated"], "fast_low": row["simulated_low"],
            "fast_high": row["simulated_high"], "closed": row["power"], **_share("coverage", held, len(own)),
            "width": float((own["high"] - own["low"]).median()), "fast_width": row["simulated_width"],
            "closed_width": row["width"], "mean": float(own["estimate"].astype(float).mean()),
        })  # fmt: skip
    return pd.DataFrame(rows)


LEVEL = 0.05


def _share(name: str, count: int, of: int) -> dict[str, float]:
    """Return a share with its 95 % Wilson interval."""
    from scipy.stats import binomtest

    if not of:
        return dict.fromkeys((name, f"{name}_low", f"{name}_high"), np.nan)
    ends = binomtest(count, of).proportion_ci(method="wilson")
    return {name: count / of, f"{name}_low": float(ends.low), f"{name}_high": float(ends.high)}
