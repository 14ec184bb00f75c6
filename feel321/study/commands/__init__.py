"""The verbs of the command line; every one imports what it needs when it is called, so that help comes at once."""

from feel321.study.commands.lab import doctor, run
from feel321.study.commands.methods import advise, chart, stress
from feel321.study.commands.signals import match, reduce
from feel321.study.commands.studies import (
    analyze,
    audit,
    build,
    check,
    demo,
    ledger,
    new,
    release,
    simulate,
    status,
    withdraw,
)

__all__ = [
    "advise",
    "analyze",
    "audit",
    "build",
    "chart",
    "check",
    "demo",
    "doctor",
    "ledger",
    "match",
    "new",
    "reduce",
    "release",
    "run",
    "simulate",
    "status",
    "stress",
    "withdraw",
]
