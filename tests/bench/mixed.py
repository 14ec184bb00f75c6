"""Mixed models against lme4 and lmerTest, in one run: `python tests/bench/mixed.py`, where R has them.

60 small studies, half of them with a spread that is truly zero; a study of 20 people, 10 recordings, 9 reducers
and 2 repeats; the shared oracle of 3 200 rows where it lies. Processor seconds, not wall time, so that a busy
machine does not decide. Agreement is counted where both found the same minimum; where they differ, the lower
criterion is the better fit, and the count says whose it is.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from feel321.analysis.mixed.model import fit_mixed

HERE = Path(__file__).resolve().parent
ORACLE = HERE.parents[2] / "shared" / "oracles" / "lmm_crossed_study" / "data.csv"
FULL = "y ~ a + b + (1 + a + b || who) + (1 | scene) + (1 | item) + (1 | who:scene)"
SAME = 1e-5


def make_study(
    rng: np.random.Generator, shape: tuple[int, int, int, int], spreads: np.ndarray
) -> pd.DataFrame:
    """Ratings of a crossed study; spreads of people, slopes, scenes, items and people's scenes."""
    table = pd.MultiIndex.from_product(
        map(range, shape), names=["who", "scene", "kind", "repeat"]
    ).to_frame(index=False)
    table["item"] = table["scene"] * shape[2] + table["kind"]
    values = rng.normal(size=(2, shape[1] * shape[2]))
    table["a"], table["b"] = values[:, table["item"]]
    person, slope, scene, item, pair = spreads
    table["y"] = 50 + 3 * table["a"] + rng.normal(0, 8, len(table))
    table["y"] += (
        person * rng.normal(size=shape[0])[table["who"]]
        + scene * rng.normal(size=shape[1])[table["scene"]]
    )
    table["y"] += slope * (
        rng.normal(size=(2, shape[0]))[:, table["who"]] * values[:, table["item"]]
    ).sum(axis=0)
    table["y"] += item * rng.normal(size=values.shape[1])[table["item"]]
    table["y"] += pair * rng.normal(size=shape[:2])[table["who"], table["scene"]]
    for name in ("who", "scene", "item"):
        table[name] = name + table[name].astype(str)
    return table


def list_jobs(rng: np.random.Generator) -> list[tuple[str, str, pd.DataFrame]]:
    full = np.array([8.0, 2.0, 5.0, 4.0, 3.0])
    jobs = []
    for _ in range(60):
        shape = (rng.integers(6, 13), rng.integers(5, 9), rng.integers(4, 7), 1)
        jobs.append(("small", FULL, make_study(rng, shape, full * rng.choice([0, 0.5, 1], 5))))
    jobs.append(("20 x 10 x 9 x 2", FULL, make_study(rng, (20, 10, 9, 2), full)))
    jobs.append((
        "same, + who:item",
        FULL + " + (1 | who:item)",
        make_study(rng, (20, 10, 9, 2), full),
    ))
    if ORACLE.is_file():
        formula = (
            "y ~ sm + tm + (1 + sm + tm || participant) + (1 | recording) + (1 | item) + (1 | pr)"
        )
        jobs.append(("oracle, 3200 rows", formula, pd.read_csv(ORACLE)))
    return jobs


def ask_r(jobs: list[tuple[str, str, pd.DataFrame]]) -> pd.DataFrame:
    with tempfile.TemporaryDirectory() as folder:
        for number, (_, _, data) in enumerate(jobs):
            data.to_csv(Path(folder) / f"{number}.csv", index=False)
        listing = [
            {"file": f"{number}.csv", "formula": formula}
            for number, (_, formula, _) in enumerate(jobs)
        ]
        (Path(folder) / "jobs.json").write_text(json.dumps(listing), encoding="utf-8")
        subprocess.run(["Rscript", HERE / "mixed.R", folder], check=True)
        return pd.DataFrame(json.loads((Path(folder) / "results.json").read_text(encoding="utf-8")))


def ask_us(jobs: list[tuple[str, str, pd.DataFrame]]) -> pd.DataFrame:
    fit_mixed(jobs[0][1], jobs[0][2])
    rows = []
    for _, formula, data in jobs:
        start = time.process_time()
        fit = fit_mixed(formula, data)
        seconds = time.process_time() - start
        rows.append((
            seconds,
            fit.criterion,
            fit.singular,
            fit.fixed["se"].to_numpy(),
            fit.fixed["df"].to_numpy(),
        ))
    return pd.DataFrame(rows, columns=["seconds", "criterion", "singular", "se", "df"])


def compare(jobs: list[tuple[str, str, pd.DataFrame]]) -> pd.DataFrame:
    r, ours = ask_r(jobs), ask_us(jobs)
    table = pd.DataFrame({
        "kind": [kind for kind, _, _ in jobs],
        "r_seconds": r["seconds"],
        "seconds": ours["seconds"],
    })
    table["lower"] = ours["criterion"] - r["criterion"]
    table["singular"], table["r_singular"] = ours["singular"], r["singular"]
    for name in ("se", "df"):
        pairs = zip(ours[name], r[name], strict=True)
        table[name] = [float(np.abs(mine / np.asarray(other) - 1).max()) for mine, other in pairs]
    return table


def main() -> int:
    table = compare(list_jobs(np.random.default_rng(2026)))
    for kind, part in table.groupby("kind", sort=False):
        same = part[part["lower"].abs() < SAME]
        ratio = part["seconds"].sum() / part["r_seconds"].sum()
        print(
            f"{kind}: {len(part)} fits, {part['singular'].sum()} singular ({part['r_singular'].sum()} in R)"
        )
        print(
            f"  time {ratio:.2f} of lme4 + lmerTest ({part['seconds'].mean():.3f} s, {part['r_seconds'].mean():.3f} s)"
        )
        print(
            f"  same minimum {len(same)}: se within {same['se'].max():.1e}, df within {same['df'].max():.1e}"
        )
        print(
            f"  lower criterion: ours {(part['lower'] < -SAME).sum()}, lme4's {(part['lower'] > SAME).sum()}"
        )
    return int((table["lower"] > SAME).any())


if __name__ == "__main__":
    sys.exit(main())
