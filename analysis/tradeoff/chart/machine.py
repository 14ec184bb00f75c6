"""What times were measured on: without its name a time means nothing."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

from analysis.tradeoff.chart.records import Machine

THREADS = 1
"""Of linear algebra while times are taken."""


def describe_machine(clock: str, *, cpu_list: Path = Path("/proc/cpuinfo")) -> Machine:
    """Describe this machine.

    Parameters
    ----------
    clock : str
        Name of the clock that is used.
    cpu_list : Path
        Where Linux names its processors; other systems are asked through `platform`.

    Returns
    -------
    Machine
        Processor, cores and versions.
    """
    from stimuli.version import __version__

    return Machine(
        processor=_name_processor(cpu_list),
        system=f"{platform.system()} {platform.release()}",
        cores=os.cpu_count() or 1,
        threads=THREADS,
        load=_tell_load(),
        clock=clock,
        python=platform.python_version(),
        numpy=version("numpy"),
        scipy=version("scipy"),
        feel321=__version__,
    )


def _name_processor(cpu_list: Path) -> str:
    try:
        lines = cpu_list.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine() or "unknown"


def _tell_load() -> float | None:
    """Give the programs that wanted to run in the last minute; not every system counts them."""
    try:
        return round(os.getloadavg()[0], 2)
    except (AttributeError, OSError):
        return None
