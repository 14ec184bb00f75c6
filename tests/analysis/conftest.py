"""A synthetic study with planted slopes, as a tidy table and as files."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from feel321.analysis.report.write import SECTIONS, write_report
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS


@dataclass(frozen=True)
class Design:
    """Ratings = 35 + spectral x spectral_match + temporal x temporal_match + recording + participant + noise."""

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


@dataclass(frozen=True)
class Files:
    ratings: Path
    manifest: Path


def list_stimuli(design: Design, rng: np.random.Generator) -> Iterator[tuple[object, ...]]:
    for number in range(design.recordings):
        for level in design.levels:
            for place, reducer in enumerate(DEFAULT_REDUCERS):
                spectral = min(1.0, place / (len(DEFAULT_REDUCERS) - 1) + rng.normal(0, 0.15))
                yield f"rec{number}", reducer, level, "test", spectral, rng.uniform(0.1, 0.9)
            if design.anchors:
                yield f"rec{number}", "original", level, "reference", np.nan, np.nan
                yield f"rec{number}", "anchor_low", level, "anchor", -2.5, 0.05
                yield f"rec{number}", "anchor_mid", level, "anchor", 0.0, 0.2


def make_manifest(design: Design, rng: np.random.Generator) -> pd.DataFrame:
    columns = ["recording", "reducer", "level", "role", "spectral_match", "temporal_match"]
    table = pd.DataFrame(list_stimuli(design, rng), columns=columns)
    table.insert(
        0, "stimulus_id", table["recording"] + "_" + table["reducer"] + "_" + table["level"]
    )
    return table


def make_session(
    design: Design, manifest: pd.DataFrame, base: np.ndarray, rng: np.random.Generator
) -> pd.DataFrame:
    bias, blocks = rng.normal(0, 6), []
    for scale in design.scales:
        for repeat in range(1, design.repeats + 1):
            rating = np.clip(base + bias + rng.normal(0, design.noise, len(base)), 0, 100).round(1)
            block = manifest[["stimulus_id", "recording", "reducer", "level"]]
            blocks.append(
                block.assign(
                    scale=scale, protocol=scale, repeat=repeat, block=repeat, rating=rating
                )
            )
    session = pd.concat(blocks, ignore_index=True)
    return session.assign(trial=np.arange(1, len(session) + 1))


def make_ratings(design: Design, manifest: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    names = manifest["recording"].unique()
    of_recording = dict(zip(names, rng.normal(0, design.recording_sd, len(names)), strict=True))
    base = 35 + manifest["recording"].map(of_recording).to_numpy(float)
    base += design.spectral * manifest["spectral_match"].clip(0, 1).fillna(1.0).to_numpy()
    base += design.temporal * manifest["temporal_match"].fillna(1.0).to_numpy()
    sessions = [
        make_session(design, manifest, base, rng).assign(participant=f"p{person:02d}")
        for person in range(design.participants)
    ]
    return pd.concat(sessions, ignore_index=True).assign(
        session=1, rejected=False, simulated=design.simulated
    )


@pytest.fixture
def tidy() -> Callable[..., pd.DataFrame]:
    """Make a tidy table of one scale, the way read_table gives it."""

    def make(seed: int = 0, **changes: object) -> pd.DataFrame:
        rng = np.random.default_rng(seed)
        design = Design(**{"scales": ("realism",), **changes})
        manifest = make_manifest(design, rng)
        ratings = make_ratings(design, manifest, rng)
        keep = ratings[["participant", "stimulus_id", "scale", "repeat", "rating", "simulated"]]
        return keep.merge(manifest, on="stimulus_id")

    return make


def write_files(folder: Path, *, seed: int = 0, **changes: object) -> Files:
    rng = np.random.default_rng(seed)
    design = Design(**changes)
    manifest = make_manifest(design, rng)
    written = Files(folder / "ratings.csv", folder / "manifest.csv")
    manifest.to_csv(written.manifest, index=False)
    make_ratings(design, manifest, rng).to_csv(written.ratings, index=False)
    return written


@pytest.fixture
def files(tmp_path: Path) -> Callable[..., Files]:
    """Write ratings.csv and manifest.csv of a synthetic study."""
    return partial(write_files, tmp_path)


@pytest.fixture
def sketched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the figures of reports, but save empty files, which takes no time."""

    def save(figure: Figure, stem: Path) -> None:  # noqa: ARG001 - the form of save_figure
        for suffix, text in (
            (".svg", '<svg xmlns="http://www.w3.org/2000/svg"></svg>'),
            (".png", ""),
        ):
            stem.with_name(f"{stem.name}{suffix}").write_text(text, encoding="utf-8")

    monkeypatch.setattr("feel321.analysis.report.folder.save_figure", save)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch, sketched: None) -> None:  # noqa: ARG001 - figures are empty too
    """Shorten reports to two sections, not drawn: enough for what files, names and captions are about."""
    monkeypatch.setattr("feel321.analysis.report.section.Picture.figure", None)
    few = [one for one in SECTIONS if one.key in {"metrics", "reducers"}]
    monkeypatch.setattr("feel321.analysis.report.write.SECTIONS", few)


@pytest.fixture(scope="session")
def study(make_once: Callable[[str, Callable[[Path], object]], Path]) -> Files:
    """Files of the default study; not to be changed."""
    folder = make_once("study", write_files)
    return Files(folder / "ratings.csv", folder / "manifest.csv")


@pytest.fixture(scope="session")
def report(study: Files, make_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """Write a report to be read only."""
    return (
        make_once(
            "report",
            lambda folder: write_report(
                study.ratings, study.manifest, folder / "report", draws=50, rng=3
            ),
        )
        / "report"
    )
