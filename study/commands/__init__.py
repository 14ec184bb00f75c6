"""The verbs of the command line; every one imports what it needs when it is called, so that help comes at once."""

from study.commands.advise import advise
from study.commands.chart import chart
from study.commands.participants import ledger, release, withdraw
from study.commands.results import analyze
from study.commands.rig import doctor
from study.commands.run import run
from study.commands.sessions import audit, simulate, status
from study.commands.signals import match, reduce
from study.commands.stress import stress
from study.commands.studies import build, check, demo, new

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
