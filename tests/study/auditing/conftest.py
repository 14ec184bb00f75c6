from __future__ import annotations

import sys
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.auditing.replay import audit_steps
from feel321.study.session.plan import make_plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.session.journal import Record
    from feel321.study.session.plan import Design, Plan

    Edit = Callable[[list[Record]], list[Record]]


def load(name: str) -> Any:
    """Load a helper that stands beside this file."""
    spec = spec_from_file_location(f"auditing_{name}", Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    sys.modules[spec.name] = module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def cheats() -> Any:
    return load("cheats")


@pytest.fixture(scope="session")
def studies() -> Any:
    return load("finished")


@pytest.fixture(scope="session")
def finished(present_once: Callable[..., list[Record]], scripted: type) -> list[Record]:
    """The records of a finished session of realism and similarity; edits make copies."""
    return present_once(scripted())


@pytest.fixture
def find(plan: Plan) -> Callable[[list[Record]], list[str]]:
    """What the audit finds in records, numbered on as an edited chain would be."""

    def audit(records: list[Record], plan: Plan = plan) -> list[str]:
        return list(
            audit_steps([replace(r, sequence=place) for place, r in enumerate(records)], plan)
        )

    return audit


@pytest.fixture
def plan_task(design: Design, stimuli: StimulusSet) -> Callable[..., Plan]:
    """The plan of a session with one task."""
    from feel321.protocols.tasks import make_task

    def make(name: str, **options: Any) -> Plan:
        task = make_task(name, **options)
        return make_plan(replace(design, tasks=(task,)), stimuli, "p01", number=1, simulated=True)

    return make
