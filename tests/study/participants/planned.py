"""A plan of four trials, for what needs no stimuli; processes of their own import it too."""

from feel321.protocols.trial import Flow, Judgement, Part, Task, Trial
from feel321.study.session.plan import Plan

TRIALS = 4


def make_trial(number: int) -> Trial:
    return Trial(
        number=number,
        block=1,
        repeat=1,
        protocol="realism",
        scale="realism",
        timing="strict",
        recording="bumps",
        parts=(Part("test", f"code{number}"),),
        judgements=(Judgement("test", f"code{number}"),),
    )


def make_small_plan(participant: str, *, number: int, simulated: bool) -> Plan:
    return Plan(
        participant=participant,
        number=number,
        simulated=simulated,
        seed=7,
        between={"grip": ("pen", "power")},
        groups={"grip": "pen" if number % 2 else "power"},
        order="williams",
        repeats=1,
        tasks=(Task("realism", "strict"),),
        flow=Flow(max_attempts=2),
        stimuli_sha256="5" * 64,
        trials=tuple(make_trial(number) for number in range(1, TRIALS + 1)),
    )
