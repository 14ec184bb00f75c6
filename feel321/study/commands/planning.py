"""The verb that plans a study: power."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.jobs import Workers
    from feel321.study.study import Study

    Verb = Callable[..., None]

MOST_STUDIES, MOST_OF_ANY = 1_000_000, 100_000


def _split_numbers(
    _context: click.Context, parameter: click.Parameter, text: str | None
) -> tuple[int, ...]:
    """Read whole numbers with commas between them, in ascending order, each once."""
    if text is None:
        return ()
    try:
        numbers = sorted({int(part) for part in text.split(",")})
    except ValueError:
        numbers = []
    if not numbers or numbers[0] < 1 or numbers[-1] > MOST_OF_ANY:
        raise click.BadParameter(
            f"must be whole numbers from 1 to {MOST_OF_ANY} with commas between them, such as 8,12,16; got {text!r}",
            param=parameter,
        )
    return tuple(numbers)


def _read_effects(
    _context: click.Context, parameter: click.Parameter, texts: tuple[str, ...]
) -> dict[str, float]:
    effects: dict[str, float] = {}
    for text in texts:
        name, mark, points = text.rpartition("=")
        try:
            value = float(points)
        except ValueError:
            value = math.nan
        if not mark or not name or not abs(value) <= shared.MOST:
            raise click.BadParameter(
                f"must be METRIC=POINTS, such as temporal_match=1.5; got {text!r}", param=parameter
            )
        if name in effects:
            raise click.BadParameter(f"got {name!r} twice; give it once", param=parameter)
        effects[name] = value
    return effects


def _numbers_option(name: str, text: str, default: str) -> Callable[[Verb], Verb]:
    return click.option(
        f"--{name}",
        callback=_split_numbers,
        metavar="N,N,...",
        help=f"{text}  [default: {default}]",
    )


@click.command(
    epilog="Example: feel321 power my-study --participants 8,12,16,24 --effect spectral_match_bounded=2 --workers 2"
)
@shared.study_argument
@_numbers_option("participants", "Numbers of participants.", "8 to 48")
@_numbers_option("recordings", "Numbers of recordings.", "half to three times the study's")
@_numbers_option("reducers", "Numbers of reducers.", "half to 1.5 times the study's")
@_numbers_option("repeats", "Ratings of each stimulus by one person.", "1 to 4")
@click.option(
    "--effect", "effects", multiple=True, callback=_read_effects, metavar="METRIC=POINTS",
    help="Slope to plan for, in points per step of the metric: +0.1 of a match, a power of ten (such as +1 dB) of "
    "others; repeatable; ATTRIBUTE/METRIC=POINTS for one scale.  "
    "[default: the slopes of the simulated observers in study.toml]",
)  # fmt: skip
@click.option(
    "--hypothesis", metavar="ATTRIBUTE/METRIC",
    help="The slope that the recommended design is for.  [default: that of --effect with the least power]",
)  # fmt: skip
@click.option(
    "--pilot", metavar="FILE",
    help="Ratings to take standard deviations from; 'study': the study's own.  [default: published ones]",
)  # fmt: skip
@click.option(
    "--manifest", type=shared.FILE, help="The stimuli of the pilot.  [default: the study's]"
)
@click.option(
    "--screening", multiple=True, metavar="RULE",
    help="Leave out the participants whom this screening rule flags; repeatable.  [default: nobody, as analyze does]",
)  # fmt: skip
@click.option(
    "--power", "wanted", type=shared.BoundedNumber(0.05, 0.995, min_open=True), default=0.8, show_default=True,
    help="Target power.",
)  # fmt: skip
@click.option(
    "--studies", type=shared.WholeNumber(0, MOST_STUDIES), default=1000, show_default=True,
    help="Simulated studies of each checked design; 0: closed form only.",
)  # fmt: skip
@shared.workers_option
@shared.seed_option(" of all simulations")
@shared.out_option("STUDY/power")
@shared.json_option
def power(
    study: Study, *, as_json: bool, out: Path | None, workers: Workers, **given: object
) -> None:
    """Find how many participants, recordings and reducers a study needs.

    Simulates this very study: its stimuli, protocols, screening, primary model and Holm's method. Writes a page, tables
    and JSON. After Ctrl-C the same command continues.
    """
    target = out or study.folder.path / "power"
    with shared.recording(study.folder, "power", target):
        found = study.power(folder=target, workers=workers, **given)  # type: ignore[arg-type]  # click checked them
    if as_json:
        shared.print_results(target, as_json=True)
        return
    shared.echo(found.summary())
    shared.print_results(target, as_json=False)
