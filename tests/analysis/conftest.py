"""A synthetic study with planted slopes, as tables and as files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from stimuli.reduce import REDUCERS

RATING_COLUMNS = (
    "participant session protocol block trial repeat stimulus_id recording reducer level reference_id scale rating "
    "response_time_s onset_s underruns rejected simulated"
).split()  # fmt: skip


@dataclass(frozen=True)
class Design:
    participants: int = 6
    recordings: int = 4
    repeats: int = 2
    scales: tuple[str, ...] = ("realism", "similarity")
    levels: tuple[str, ...] = ("as_is",)
    spectral: float = 30.0
    temporal: float = 0.0
    noise: float = 8.0
    recording_sd: float = 6.0
    anchors: bool = True
    simulated: bool = True


def make_manifest(design: Design, rng: np.random.Generator) -> pd.DataFrame:
    rows = []
    for number in range(design.recordings):
        for level in design.levels:
            for place, reducer in enumerate(REDUCERS):
                best = place / (len(REDUCERS) - 1)
                spectral = min(1.0, best + rng.normal(0, 0.15)) if reducer != "dft321" else 1.0
                rows.append((f"rec{number}", reducer, level, "test", spectral, rng.uniform(0.1, 0.9)))
            if design.anchors:
                rows.append((f"rec{number}", "original", level, "reference", np.nan, np.nan))
                rows.append((f"rec{number}", "anchor_low", level, "anchor", -2.5, 0.05))
                rows.append((f"rec{number}", "anchor_mid", level, "anchor", 0.0, 0.2))
    columns = ["recording", "reducer", "level", "role", "spectral_match", "temporal_match"]
    table = pd.DataFrame(rows, columns=columns)
    table.insert(0, "stimulus_id", table["recording"] + "_" + table["reducer"] + "_" + table["level"])
    return table


def make_ratings(design: Design, manifest: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    spectral = manifest["spectral_match"].clip(0, 1).fillna(1.0).to_numpy()
    temporal = manifest["temporal_match"].fillna(1.0).to_numpy()
    of_recording = dict(zip(manifest["recording"].unique(), rng.normal(0, design.recording_sd, design.recordings)))
    base = 35 + design.spectral * spectral + design.temporal * temporal + manifest["recording"].map(of_recording)
    rows = []
    for person in range(design.participants):
        bias, trial = rng.normal(0, 6), 0
        for scale in design.scales:
            for repeat in range(1, design.repeats + 1):
                ratings = np.clip(base + bias + rng.normal(0, design.noise, len(base)), 0, 100).round(1)
                for stimulus, rating in zip(manifest.itertuples(), ratings):
                    trial += 1
                    rows.append(
                        (f"p{person:02d}", 1, scale, repeat, trial, repeat, stimulus.stimulus_id, stimulus.recording,
                         stimulus.reducer, stimulus.level, f"{stimulus.recording}_original", scale, rating, 1.2, 0.1 * trial,
                         0, False, design.simulated)
                    )  # fmt: skip
    return pd.DataFrame(rows, columns=RATING_COLUMNS)


@dataclass(frozen=True)
class Files:
    ratings: Path
    manifest: Path


@pytest.fixture
def tidy() -> Callable[..., pd.DataFrame]:
    """Make a tidy table of one scale, the way read_table gives it."""

    def make(seed: int = 0, scale: str = "realism", **changes: object) -> pd.DataFrame:
        rng = np.random.default_rng(seed)
        design = Design(scales=(scale,), **changes)
        manifest = make_manifest(design, rng)
        ratings = make_ratings(design, manifest, rng)
        keep = ratings[["participant", "stimulus_id", "scale", "repeat", "rating", "simulated"]]
        return keep.merge(manifest, on="stimulus_id")

    return make


@pytest.fixture
def files(tmp_path: Path) -> Callable[..., Files]:
    """Write ratings.csv and manifest.csv of a synthetic study."""

    def write(seed: int = 0, folder: str = "study", **changes: object) -> Files:
        rng = np.random.default_rng(seed)
        design = Design(**changes)
        manifest = make_manifest(design, rng)
        target = tmp_path / folder
        target.mkdir(exist_ok=True)
        manifest.to_csv(target / "manifest.csv", index=False)
        make_ratings(design, manifest, rng).to_csv(target / "ratings.csv", index=False)
        return Files(target / "ratings.csv", target / "manifest.csv")

    return write
