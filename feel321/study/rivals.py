"""Rival metrics of a study's stimuli, for an analysis that compares them with the match metrics."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd

from feel321.stimuli.condition import condition
from feel321.stimuli.recording import Recording
from feel321.stimuli.rivals.catalog import RIVALS, measure_batch
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.sets.render import find_reducer


def measure_rivals(
    recordings: Sequence[Recording], stimuli: StimulusSet, recipe: Recipe
) -> pd.DataFrame:
    """Measure every rival metric that the manifest lacks, for every test stimulus.

    Like the manifest's match metrics they are those of the reduction: of the recording conditioned by the recipe, at
    its own rate, before level, resampling and fades. Index stimulus_id, a column per metric, NaN where there is nothing
    to compare.
    """
    lacking = [name for name in RIVALS if name not in stimuli.to_frame().columns]
    tests = [stimulus for stimulus in stimuli if stimulus.role == "test"]

    def measure(recording: Recording) -> dict[str, dict[str, float]]:
        ready = condition(recording, recipe.conditioning)
        names = {one.reducer for one in tests if one.recording == recording.name}
        return {
            name: {
                metric: float(value)
                for metric, value in measure_batch(
                    ready.acceleration,
                    np.asarray(
                        find_reducer(recipe, name, ready.name)(ready.acceleration, ready.rate_hz)
                    ),
                    ready.rate_hz,
                ).items()
            }
            for name in names
        }

    # Threads: nearly all of the work is done by libraries that release the interpreter.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = dict(
            zip([one.name for one in recordings], pool.map(measure, recordings), strict=True)
        )
    return pd.DataFrame(
        [found[stimulus.recording][stimulus.reducer] for stimulus in tests],
        index=pd.Index([stimulus.stimulus_id for stimulus in tests], name="stimulus_id"),
        columns=lacking,
    )
