"""Power of a planned study: `find_power` of one design, `plan_power` of many."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.power import closed, draw, engine, simulate
from feel321.analysis.power.design import LEVEL, Power, PowerDesign, Truth
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.primary.plan import SCENE, SOURCE
from feel321.doors import as_path, follow
from feel321.jobs import ALONE, Workers, as_workers

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import PathLike, Progress, Samples

NONE = float("nan")


def find_power(  # noqa: PLR0913 - a design and a truth; how many studies, who does them, where they are kept
    design: PowerDesign,
    truth: Truth,
    *,
    studies: int = 1000,
    seed: int = 0,
    workers: int | Workers = ALONE,
    keep: PathLike | None = None,
    progress: Progress = False,
) -> Power:
    """Find the power of a planned study, in closed form and by simulating it.

    Parameters
    ----------
    design : PowerDesign
        The study: its stimuli, metrics, attributes and sizes.
    truth : Truth
        Planted slopes, and how people, stimuli and ratings differ.
    studies : int
        Simulated studies; 0 for the closed form alone.
    seed : int
        Random seed; the same seed gives the same numbers for any number of workers.
    workers : int or Workers
        Number of processes, or what else simulates.
    keep : path, optional
        A folder that keeps results, chunk by chunk: an interrupted call resumes from there, and a completed one is
        not recomputed.
    progress : bool or callable
        Whether to show a progress bar; or called with the numbers of chunks done and to do.

    Returns
    -------
    Power
        Power, interval widths, coverage and false positives of every slope, and of every difference of two.

    Raises
    ------
    ValueError
        If slopes name no metric of the design, or a number is too small.

    Notes
    -----
    Closed form: the standard error of generalised least squares with the planted spreads, SE² = σ_S²/P + V_C + 1
    / (SS_w/v + SS_r/(v + m v_r)) with σ_S between the slopes of P people, v = σ_I² + (σ_PI² + σ_e²/K)/P of a stimulus
    and v_r = σ_R² + σ_PR²/P of a reducer in m recordings; V_C is what slopes that differ between recordings add to an
    estimate that does not know it (the whole then is 4 to 9 % more than with the best weights, in designs of 4 to 20
    recordings); degrees of freedom by Welch and Satterthwaite, the noncentral t distribution at the level of Holm's
    first step. It knows neither the ends of the scale nor lapses, careless people and the penalty of few reducers.

    Simulation: each study draws people, stimuli and ratings, is analysed as `fit_primary` analyses it (the same
    numbers: the model is fitted by the small matrices of a balanced design) and its slopes are tested by Holm's method
    over attributes x metrics. The same people rate the same stimuli once more without any slope: these studies give
    the false positives. Power is the share of studies that gave a test; what gave none is counted in `Power.counts`.
    Coverage is that of the slope which is left by the ends of the scale and by lapses, in careful people.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from feel321 import analysis
    >>> rng = np.random.default_rng(1)
    >>> items = pd.DataFrame({"recording": np.repeat(range(6), 4), "reducer": list(range(4)) * 6,
    ...     "match": rng.uniform(0, 1, 24)})
    >>> design = analysis.PowerDesign(items, ["match"], participants=12)
    >>> power = analysis.find_power(design, analysis.Truth({"match": 20.0}), studies=0)
    >>> power.table[["metric", "slope", "power", "ceiling"]].round(1)
      metric  slope  power  ceiling
    0  match   20.0    0.4      0.6
    """
    if studies < 0:
        raise ValueError(f"studies must be 0 or more, got {studies}; give 1000")
    scenario = draw.Scenario(design, truth)
    table, differences = _tabulate_closed(scenario)
    found = None
    if studies:
        place = None if keep is None else as_path(keep, "keep")
        with follow(progress, "power") as move:
            found = simulate.simulate_studies(
                design, truth, studies=studies, seed=seed, workers=as_workers(workers), keep=place,
                progress=move,
            )  # fmt: skip
    shares = Shares(found, design)
    table, differences = shares.add_slopes(table), shares.add_differences(differences)
    return Power(
        design=design, truth=truth, table=table, differences=differences, studies=studies,
        counts=simulate.tabulate_counts(found.counts if found else {}),
        family=shares.find_family(), seed=seed, answer=describe_power(table, design),
        notes=(*_list_notes(design, truth, found), *note_untested(scenario)),
    )  # fmt: skip


def _tabulate_closed(scenario: draw.Scenario) -> tuple[DataFrame, DataFrame]:
    """Tabulate what the closed form gives of slopes, and of their differences."""
    import pandas as pd

    design, planted = scenario.design, scenario.planted
    sets = closed.draw_sets(scenario)
    spreads = scenario.stimuli.within.std(axis=0, ddof=1)
    units = np.eye(len(design.metrics))
    slopes = [closed.ClosedForm(scenario, sets, unit, design.level) for unit in units]
    rows = [
        {"attribute": attribute, "metric": metric, **_list_slope(form, slope, spread)}
        for attribute, values in zip(design.attributes, planted.slopes, strict=True)
        for metric, slope, form, spread in zip(design.metrics, values, slopes, spreads, strict=True)
    ]
    pairs = engine.list_pairs(len(units))
    weights = [spreads[one] * units[one] - spreads[two] * units[two] for one, two in pairs]
    forms = [closed.ClosedForm(scenario, sets, one, LEVEL) for one in weights]
    gaps = [
        {"attribute": attribute, "first": design.metrics[one], "second": design.metrics[two]}
        | _list_difference(form, float(form.weights @ values))
        for attribute, values in zip(design.attributes, planted.slopes, strict=True)
        for (one, two), form in zip(pairs, forms, strict=True)
    ]
    return pd.DataFrame(rows), pd.DataFrame(gaps)


def _list_difference(form: closed.ClosedForm, value: float) -> dict[str, float]:
    se, df = form.find_errors()
    return {
        "difference": value, "se": se, "df": df, "width": form.find_width(), "power": form.find_power(value),
        "ceiling": form.find_ceiling(value), "detectable": form.find_detectable(form.scenario.design.wanted),
    }  # fmt: skip


def _list_slope(form: closed.ClosedForm, slope: float, spread: float) -> dict[str, float]:
    row, wanted = _list_difference(form, slope), form.scenario.design.wanted
    row = {"slope": row.pop("difference"), **row}
    return row | {
        "detectable_points": row["detectable"] * spread,
        "participants_needed": form.find_participants(slope, wanted),
        "recordings_needed": form.find_recordings(slope, wanted),
    }


class Share(NamedTuple):
    """A share of studies with its 95 % Wilson interval, and their number; NaN without any."""

    share: float
    low: float
    high: float
    known: int


def find_share(hits: NDArray[np.bool_], known: NDArray[np.bool_]) -> Share:
    """Compute the share of hits among what is known."""
    from scipy.stats import binomtest

    count = int(known.sum())
    if not count:
        return Share(NONE, NONE, NONE, 0)
    number = int((hits & known).sum())
    interval = binomtest(number, count).proportion_ci(method="wilson")
    return Share(number / count, float(interval.low), float(interval.high), count)


class Shares:
    """Power, coverage and false positives in simulated studies; NaN without any."""

    def __init__(self, found: simulate.Studies | None, design: PowerDesign) -> None:
        from scipy.stats import t

        self.count = len(design.metrics)
        rows = (0, 2, len(design.attributes), self.count + len(engine.list_pairs(self.count)))
        self.tests = found.tests if found else np.empty((*rows, 3))
        self.kept = found.kept if found else np.empty((0, *rows[2:]))
        self.estimate, self.se, self.df = np.moveaxis(self.tests, -1, 0)
        self.p = 2 * t.sf(np.abs(self.estimate / self.se), self.df)
        self.margin = t.ppf(1 - LEVEL / 2, self.df) * self.se
        slopes = self.p[..., : self.count]
        flat = slopes.reshape(-1, len(design.hypotheses))
        holm = [adjust_holm(row) for row in flat.tolist()]
        self.holm = np.reshape(holm, slopes.shape)

    def _list(self, place: tuple[int, int], p: Samples) -> dict[str, float]:
        """List power, width and coverage of one test; place: attribute and test, p: of planted studies."""
        known, margin = np.isfinite(p), self.margin[(slice(None), 0, *place)]
        found = find_share(p < LEVEL, known)
        kept = self.kept[(slice(None), *place)]
        missed = np.abs(self.estimate[(slice(None), 0, *place)] - kept) > margin
        coverage = find_share(np.asarray(~missed), known)
        return {
            "kept": float(kept.mean()) if len(kept) else NONE,
            "simulated": found.share, "simulated_low": found.low, "simulated_high": found.high,
            "simulated_width": float(np.median(2 * margin[known])) if known.any() else NONE,
            "coverage": coverage.share, "coverage_low": coverage.low, "coverage_high": coverage.high,
            "tests": found.known,
        }  # fmt: skip

    def add_slopes(self, table: DataFrame) -> DataFrame:
        """Add to the closed form of every hypothesis what was simulated."""
        import pandas as pd

        rows = []
        for place in np.ndindex(self.kept.shape[1], self.count):
            null = self.p[(slice(None), 1, *place)]
            false = find_share(null < LEVEL, np.isfinite(null))
            rows.append(
                self._list(place, self.holm[(slice(None), 0, *place)])
                | {"false_positives": false.share, "false_low": false.low, "false_high": false.high}
                | {"null_tests": false.known}
            )
        return table.join(pd.DataFrame(rows))

    def add_differences(self, table: DataFrame) -> DataFrame:
        """Add to the closed form of every difference what was simulated."""
        import pandas as pd

        places = [
            (row, column)
            for row in range(self.kept.shape[1])
            for column in range(self.count, self.kept.shape[2])
        ]
        rows = [self._list(place, self.p[(slice(None), 0, *place)]) for place in places]
        return table.join(pd.DataFrame(rows))

    def find_family(self) -> tuple[float, float, float]:
        """Compute the share of null studies with any false positive after Holm's method."""
        null = self.holm[:, 1].reshape(len(self.holm), self.holm[0:1, 1].size or 1)
        wrong, known = (np.asarray(one.any(axis=1)) for one in (null < LEVEL, np.isfinite(null)))
        return find_share(wrong, known)[:3]


def describe_power(table: DataFrame, design: PowerDesign) -> str:
    """Describe in a sentence the power of the planted slope that has the least."""
    planted = table[table["slope"] != 0]
    row = (planted if len(planted) else table).sort_values("power", kind="stable").iloc[0]
    what = f"{row['metric']} on {row['attribute']}"
    study = describe_design(design)
    if math.isnan(row["power"]):
        return f"A slope of {what} is not estimable with {study}."
    shown = f"{row['power']:.0%}"
    if not math.isnan(row["simulated"]):
        low, high = (f"{100 * row[name]:.0f}" for name in ("simulated_low", "simulated_high"))
        shown = f"{row['simulated']:.0%} (95 % interval of the simulation {low} to {high} %, closed form {shown})"
    tests = len(design.hypotheses)
    adjusted = f", adjusted for {tests} tests" if tests > 1 else ""
    slope = f"a slope of {row['slope']:.3g} points per unit of {what}"
    return f"With {study}, the power to find {slope} is {shown}{adjusted}."


def describe_design(design: PowerDesign) -> str:
    """Describe a design's sizes."""
    numbers = (
        (design.participants, "participant"), (design.recordings, "recording"), (design.reducers, "reducer"),
        (design.repeats, "rating"),
    )  # fmt: skip
    people, scenes, kinds, ratings = (f"{n} {name}{'s' * (n != 1)}" for n, name in numbers)
    return f"{people}, {scenes}, {kinds} and {ratings} of each stimulus"


def _list_notes(
    design: PowerDesign, truth: Truth, found: simulate.Studies | None
) -> tuple[str, ...]:
    notes = [f"Standard deviations: {truth.source}."]
    if len(design.attributes) > 1:
        notes.append(
            "Attributes are taken to be independent of each other, although the same people rate them."
        )
    if not design.is_own:
        notes.append(
            "Recordings and reducers are drawn from those of the stimulus set anew for every study; where there are "
            "more than the set has, some are used more than once, with the same metrics."
        )
    if SOURCE in design.items and not design.items.drop_duplicates(SCENE)[SOURCE].is_unique:
        notes.append(
            "Several recordings come from one source; what else they share is not simulated, so actual "
            "power is lower."
        )
    if found and design.screening:
        left, rules = found.people[:, 0].mean(), ", ".join(design.screening)
        people = f"{left:.1f} of {design.participants} participants"
        notes.append(f"Screening ({rules}) leaves {people} on average.")
    if found and found.damaged:
        notes.append(
            f"Kept results that could not be read were computed anew: {', '.join(found.damaged)}."
        )
    return (*notes, *(_note_counts(found) if found else ()))


def note_untested(scenario: draw.Scenario) -> list[str]:
    """Name planted slopes that cannot be tested in the study, and why."""
    design, sets = scenario.design, closed.draw_sets(scenario)
    forms = [closed.ClosedForm(scenario, sets, one, LEVEL) for one in np.eye(len(design.metrics))]
    lacks = dict(zip(design.metrics, (form.find_lack() for form in forms), strict=True))
    return [
        f"The planted slope of {metric} on {attribute} cannot be tested: {lacks[metric]}."
        for attribute, metric in design.hypotheses
        if lacks[metric] and scenario.truth.find_slope(attribute, metric)
    ]


def _note_counts(found: simulate.Studies) -> list[str]:
    """Say how many models were singular, had no test or failed, and why."""
    total, sums = (
        found.counts.total(),
        dict.fromkeys((engine.SINGULAR, engine.NOT_ESTIMABLE, engine.FAILED), 0),
    )
    reasons: dict[str, None] = {}
    for (_, outcome, reason), number in found.counts.items():
        if outcome in sums:
            sums[outcome] += number
            reasons |= {reason: None} if reason else {}
    said = f"Of {total} simulated models, {sums[engine.SINGULAR]} have a spread estimated as zero, which is normal"
    if lost := sums[engine.NOT_ESTIMABLE] + sums[engine.FAILED]:
        return [f"{said}; {lost} gave no test and are excluded ({'; '.join(reasons)})."]
    return [f"{said}; all gave a test."]
