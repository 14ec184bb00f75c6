from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.evidence.replay import audit_steps
from feel321.study.session.journal import Record
from feel321.study.session.plan import Design, Plan, make_plan

Edit = Callable[[list[Record]], list[Record]]


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
