"""What a power analysis is about: a study's design, and the truth that is planted in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import check_columns
from feel321.analysis.primary.plan import ITEM, REDUCER, SCENE, SOURCE, find_recording_slope
from feel321.doors import as_names

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.primary.model import Primary

LEVEL = 0.05
"""Of all tests of a study together, by Holm's method."""

ENOUGH = 0.8
"""Power that is asked for."""

LEAST = {"participants": 6, "recordings": 4, "reducers": 3}
"""No smaller study is advised, however large the slope: intervals over fewer are too unsure of themselves."""

LOW, HIGH = 0.0, 100.0
"""Ends of the scale."""

SIZES = ("participants", "recordings", "reducers", "repeats")
"""What a plan varies."""

GROUPS = {
    "person_sd": "participant", "recording_sd": SCENE, "item_sd": ITEM, "reducer_sd": REDUCER,
    "person_recording_sd": f"participant:{SCENE}", "person_reducer_sd": f"participant:{REDUCER}",
}  # fmt: skip
"""Field of a truth -> grouping factor of the primary model."""

SPREADS = (*GROUPS, "person_item_sd", "rating_sd")
"""Standard deviations of a truth, in points; those of people's slopes are apart."""

CARELESS = ("straight_liners", "random_clickers", "scale_reversers")
SHARES = ("lapse_rate", *CARELESS)


@dataclass(frozen=True, slots=True, eq=False)
class PowerDesign:
    """The design of a study that is planned.

    Parameters
    ----------
    items : DataFrame
        The study's own stimulus set, one row per test stimulus: ``recording``, ``reducer`` and a column per metric;
        ``item`` names each, if it is there, and ``source`` what several recordings come from.
    metrics : sequence of str
        The metrics of the primary model, all in one model.
    attributes : sequence of str
        What people rate (scales). Each attribute has a model; attributes x metrics is the number of hypotheses.
    participants : int
        People whose ratings are collected, 3 or more.
    repeats : int
        Ratings that one person gives to one stimulus on one attribute; the analysis averages them.
    recordings, reducers : int, optional
        How many the study has; as many as `items` if left out. With another number every simulated study draws its own
        from those of `items`: without replacement, and where more are asked for, each as often as every other but for
        one. A recording keeps its reducers' metrics; a second copy counts as another recording with the same metrics.
    wanted : float
        Power that is asked for.

    Raises
    ------
    ValueError
        If a column is missing, a metric is not finite, a stimulus is listed twice, or a number is too small.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> items = pd.DataFrame({"recording": list("aabb"), "reducer": ["x", "y"] * 2, "match": [0.2, 0.7, 0.4, 0.8]})
    >>> design = analysis.PowerDesign(items, ["match"], participants=12, recordings=4)
    >>> design.n_items, design.hypotheses
    (8, (('rating', 'match'),))
    """

    items: DataFrame
    metrics: tuple[str, ...]
    attributes: tuple[str, ...] = ("rating",)
    participants: int = 20
    repeats: int = 1
    recordings: int = 0
    reducers: int = 0
    wanted: float = ENOUGH

    def __post_init__(self) -> None:
        """Refuse what is no study, and settle names and numbers."""
        for name in ("metrics", "attributes"):
            names = as_names(getattr(self, name), name)
            if not names:
                raise ValueError(f"{name} must name at least one, got none")
            object.__setattr__(self, name, names)
        object.__setattr__(self, "items", self._read_items())
        for name, own in zip(("recordings", "reducers"), self._count_own(), strict=True):
            object.__setattr__(self, name, int(getattr(self, name)) or own)
        if not LEVEL < self.wanted < 1:
            raise ValueError(f"wanted must be between {LEVEL} and 1, got {self.wanted}")
        for name, least in zip(SIZES, (3, 1, 1, 1), strict=True):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be {least} or more, got {getattr(self, name)}")

    def _read_items(self) -> DataFrame:
        items, metrics = self.items, list(self.metrics)
        check_columns(items, [SCENE, REDUCER, *metrics], "items")
        if ITEM not in items:
            names = items[SCENE].astype(str) + "/" + items[REDUCER].astype(str)
            items = items.assign(**{ITEM: names})
        kept = [SCENE, REDUCER, ITEM, *([SOURCE] if SOURCE in items else []), *metrics]
        items = items[kept].reset_index(drop=True)
        again = int(items.duplicated([SCENE, REDUCER]).sum())
        bad = int((~np.isfinite(items[metrics].to_numpy(np.float64))).any(axis=1).sum())
        if again or bad:
            raise ValueError(
                "items must have one stimulus per recording and reducer, of one level, and finite metrics, got "
                f"{again} stimuli once more and {bad} without; leave them out"
            )
        return items

    def _count_own(self) -> tuple[int, int]:
        return int(self.items[SCENE].nunique()), int(self.items[REDUCER].nunique())

    @property
    def hypotheses(self) -> tuple[tuple[str, str], ...]:
        """Attribute and metric of every slope that is tested; Holm's method is over these."""
        return tuple(product(self.attributes, self.metrics))

    @property
    def level(self) -> float:
        """Level of the first step of Holm's method: 0.05 over the number of hypotheses."""
        return LEVEL / len(self.hypotheses)

    @property
    def sizes(self) -> dict[str, int]:
        """The numbers that tell it from other designs of a plan."""
        return {name: int(getattr(self, name)) for name in SIZES}

    @property
    def is_own(self) -> bool:
        """Whether the study has just the recordings and reducers of `items`."""
        return (self.recordings, self.reducers) == self._count_own()

    @property
    def n_items(self) -> int:
        """Stimuli of the study, on average over what is drawn."""
        scenes, kinds = self._count_own()
        return round(len(self.items) * self.recordings * self.reducers / (scenes * kinds))

    @property
    def trials(self) -> int:
        """Ratings that one person gives: stimuli x repeats x attributes."""
        return self.n_items * self.repeats * len(self.attributes)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is true of people and stimuli in simulated studies.

    Ratings are ``mean + slope x (metric - its mean over the stimulus set)``, plus what people, recordings, stimuli and
    reducers differ by, rounded to `step` and kept within 0 to 100. All attributes of a study have the same truth unless
    `slopes` names them, and are independent of each other, although the same people rate them.

    Parameters
    ----------
    slopes : Mapping of str to float
        Metric -> points per unit of the metric; 0 where it is left out. ``attribute/metric`` is for one attribute.
    slope_sds : Mapping of str to float
        Metric -> standard deviation of people's own slopes, in the same unit; where it is left out, as much as makes
        people differ by `slope_points` over one standard deviation of the metric within recordings.
    recording_slope_sds : Mapping of str to float
        Metric -> standard deviation of recordings' own slopes, the same for everybody; where it is left out, as for
        people.
    slope_points, recording_slope_points : float
        See `slope_sds` and `recording_slope_sds`; in points.
    person_sd, recording_sd, item_sd, reducer_sd : float
        How people, recordings, stimuli and reducers differ besides slopes and metrics, for everyone; in points.
    person_recording_sd, person_reducer_sd, person_item_sd : float
        How the same differ for one person besides; in points.
    rating_sd : float
        How two ratings of the same stimulus by the same person differ from their mean; in points.
    mean : float
        Mean rating before rounding and the ends of the scale, in points.
    step : float
        Ratings are rounded to multiples of this; 0 for not at all.
    bounded : bool
        Whether ratings end at 0 and 100.
    lapse_rate : float
        Share of ratings unrelated to the stimulus, anywhere on the scale.
    straight_liners, random_clickers, scale_reversers : float
        Shares of people who leave the slider at one place, set it anywhere, or use the scale upside down.
    source : str
        Where the standard deviations come from, in words.

    Raises
    ------
    ValueError
        If a standard deviation is negative or a share is not from 0 to 1.

    Notes
    -----
    The defaults are rounded estimates of the primary model on ratings of 70 videos by 26 people (Netflix Public, 0 to
    100). Nothing was rated twice: how single ratings (14.9 points) divide into `person_item_sd` and `rating_sd` is an
    assumption. Give those of vibrations as soon as there are some: `Truth.from_fit`.

    Examples
    --------
    >>> from feel321 import analysis
    >>> truth = analysis.Truth({"spectral_match_bounded": 25.0}, item_sd=5)
    >>> truth.find_slope("realism", "spectral_match_bounded"), truth.find_slope("realism", "temporal_match")
    (25.0, 0.0)
    """

    slopes: Mapping[str, float] = field(default_factory=dict)
    slope_sds: Mapping[str, float] = field(default_factory=dict)
    recording_slope_sds: Mapping[str, float] = field(default_factory=dict)
    slope_points: float = 3.0
    recording_slope_points: float = 3.0
    person_sd: float = 8.0
    recording_sd: float = 5.0
    item_sd: float = 7.0
    reducer_sd: float = 5.0
    person_recording_sd: float = 5.0
    person_reducer_sd: float = 2.0
    person_item_sd: float = 8.0
    rating_sd: float = 12.5
    mean: float = 50.0
    step: float = 0.1
    bounded: bool = True
    lapse_rate: float = 0.0
    straight_liners: float = 0.0
    random_clickers: float = 0.0
    scale_reversers: float = 0.0
    source: str = "ratings of 70 videos by 26 people (Netflix Public); no pilot data"

    def __post_init__(self) -> None:
        """Refuse what cannot be true."""
        points = (*SPREADS, "slope_points", "recording_slope_points", "step")
        spreads = [(name, getattr(self, name)) for name in points]
        for name, value in (*spreads, *self.slope_sds.items(), *self.recording_slope_sds.items()):
            if not 0 <= value < np.inf:
                raise ValueError(f"{name} must be 0 or more, got {value}")
        shares = {name: getattr(self, name) for name in SHARES}
        careless = sum(shares[name] for name in CARELESS)
        if not all(0 <= share <= 1 for share in shares.values()) or careless > 1 + 1e-9:
            raise ValueError(
                f"{', '.join(SHARES)} must be from 0 to 1, the careless at most 1 together, got {shares}"
            )

    @classmethod
    def from_fit(cls, primary: Primary, *, repeats: int = 1, **changes: object) -> Truth:
        """Take the standard deviations, slopes and mean of a fitted primary model, such as that of pilot data.

        Parameters
        ----------
        primary : Primary
            From `fit_primary`.
        repeats : int
            Ratings that each mean of the model was taken over, where it was (`Primary.averaged`).
        **changes : object
            Any field of a truth, instead of the estimate.

        Returns
        -------
        Truth
            With slopes of the fit: give ``slopes`` instead, for those of a small pilot are as uncertain as the pilot.

        Raises
        ------
        ValueError
            If a change is no field of a truth, or no possible value.

        Notes
        -----
        The residual of a model of means holds what a person thinks of a stimulus, and what averaging leaves of repeats.
        `rating_sd` among the changes separates them; without it, all is taken for the first.
        """
        if unknown := set(changes) - set(cls.__dataclass_fields__):
            raise ValueError(f"changes must be fields of a Truth, got {sorted(unknown)[0]!r}")
        fit, metrics = primary.fit, list(primary.slopes.index)
        spreads = {
            (row["group"], row["term"]): float(row["sd"])
            for row in fit.variances.to_dict("records")
        }
        found: dict[str, object] = {
            name: spreads.get((group, "(Intercept)"), 0.0) for name, group in GROUPS.items()
        }
        own, given = spreads.get(("participant:item", "(Intercept)")), changes.get("rating_sd")
        if own is None:
            noise = float(given) ** 2 / repeats if isinstance(given, int | float) else 0.0
            own = float(np.sqrt(max(fit.residual_sd**2 - noise, 0.0)))
            found["rating_sd"] = 0.0
        else:
            found["rating_sd"] = fit.residual_sd
        found |= {
            "person_item_sd": own,
            "slopes": primary.slopes["estimate"].to_dict(),
            "slope_sds": {name: spreads.get(("participant", f"{name}_w"), 0.0) for name in metrics},
            "recording_slope_sds": {name: find_recording_slope(spreads, name) for name in metrics},
            "mean": float(primary.model_frame["rating"].mean()),
            "source": f"the primary model of {fit.n_levels.get('participant', 0)} people's ratings",
        }
        return cls(**(found | changes))  # type: ignore[arg-type]  # checked by name

    def find_slope(self, attribute: str, metric: str) -> float:
        """Find the planted slope of one hypothesis.

        Parameters
        ----------
        attribute, metric : str
            The hypothesis.

        Returns
        -------
        float
            Points per unit of the metric.
        """
        return float(self.slopes.get(f"{attribute}/{metric}", self.slopes.get(metric, 0.0)))
