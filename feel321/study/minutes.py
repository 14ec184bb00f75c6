"""How long a session takes: its agenda is worked through on paper, at the pace of those who were there before.

What is felt takes as long as the stimuli do. What people add, by answering, feeling again and reading, is taken from
the journals of real participants; before there are any, from the response times of simulated ones.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from math import exp
from statistics import median

from feel321.protocols.agenda import SECONDS, Agenda
from feel321.protocols.threshold import name_tone
from feel321.protocols.trial import VALID, Page, Trial
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.folder import StudyFolder
from feel321.study.session.engine import find_gap
from feel321.study.session.events import PageRead, QuestionAnswered, TrialRated, TrialShown
from feel321.study.session.journal import Records
from feel321.study.session.plan import Dossier, Plan, replay

# Mean and standard deviation of the logarithm of a response time in s: a median of 2.0 s.
UNHURRIED = (0.7, 0.4)

STROKE_S = 3.0  # duration of a stroke over the real surface
PAGE_S = 10.0  # for a page that may be left at once, until real participants have read some
Durations = Mapping[str, float]  # duration of the stimuli of each recording, in s


@dataclass(frozen=True, slots=True)
class Pace:
    """The time that people add to what is felt.

    answer_s: mean time of a judgement beyond feeling every part once, by protocol; other_s: that of other protocols;
    page_s: median time on a page beyond its shortest; participants: number of real people behind it.
    """

    answer_s: Mapping[str, float] = field(default_factory=dict)
    other_s: float = exp(UNHURRIED[0] + UNHURRIED[1] ** 2 / 2)
    page_s: float = PAGE_S
    participants: int = 0


SIMULATED = Pace(page_s=0.0)  # the pace of simulated participants, who do not read


@dataclass(frozen=True, slots=True)
class Length:
    """Minutes that sessions of a study take, from the shortest to the longest group; see `Pace`."""

    low_min: float
    high_min: float
    trials: int
    participants: int

    def describe(self) -> str:
        """Write it in one line."""
        ends = dict.fromkeys(f"{end:.0f}" for end in (self.low_min, self.high_min))
        who = f"{self.participants} so far" if self.participants else "simulated participants"
        took = f"{' to '.join(ends)} min with {self.trials} trials"
        return f"a session takes about {took} (at the pace of {who})"


def find_durations(stimuli: StimulusSet) -> dict[str, float]:
    """Find the duration of the stimuli of each recording, in s."""
    return {row.recording: row.duration_s for row in stimuli.stimuli}


def time_trials(plan: Plan, durations: Durations) -> Callable[[Trial], float]:
    """Make the function that computes how long it takes to feel every part of a trial once, in s."""
    tasks, known = {task.protocol: task for task in plan.tasks}, dict(durations)
    if (block := plan.threshold) is not None:
        # Silence before a tone is the block's own.
        tone_s = block.duration_s + block.gap_s - plan.flow.gap_s
        known |= {name_tone(frequency): tone_s for frequency in block.frequencies_hz}

    def measure_felt(trial: Trial) -> float:
        gap_s = find_gap(trial, tasks.get(trial.protocol), plan.flow)
        stimulus_s = gap_s + known.get(trial.recording, 0.0)
        return sum(stimulus_s if part.stimulus_id else STROKE_S for part in trial.parts)

    return measure_felt


def count_down(
    plan: Plan,
    durations: Durations,
    pace: Pace,
    *,
    agenda: Agenda | None = None,
    clock_s: float = 0.0,
) -> dict[int, float]:
    """Work through what is left of a session, every answer a good one; gives the time left in s, by trials done."""
    agenda = agenda or Agenda(plan.trials, plan.flow, plan.questions)
    tasks, measure_felt = {task.protocol: task for task in plan.tasks}, time_trials(plan, durations)
    reached: dict[int, float] = {}
    while (step := agenda.ask()) is not None:
        reached.setdefault(agenda.done, clock_s)
        if isinstance(step, Page):
            clock_s += step.least_s + pace.page_s
            agenda.tell_page(step.key, time_s=clock_s)
        else:
            answer_s = pace.answer_s.get(step.protocol, pace.other_s) * len(step.judgements)
            task = tasks.get(step.protocol)
            least_s = (task.onset_s or 0.0) if task else 0.0
            clock_s += max(measure_felt(step) + answer_s, least_s)
            is_known = any(judgement.expected for judgement in step.judgements)
            agenda.tell_trial(step.number, VALID, as_expected=is_known or None, time_s=clock_s)
    reached.setdefault(agenda.done, clock_s)
    return {done: clock_s - time_s for done, time_s in reached.items()}


def measure_length(plans: Iterable[Plan], durations: Durations, pace: Pace) -> Length:
    """Measure how long whole sessions take, at least one."""
    whole = [(count_down(plan, durations, pace)[0] / SECONDS, plan.trials) for plan in plans]
    minutes = [taken for taken, _ in whole]
    most = max(sum(trial.phase == "main" for trial in trials) for _, trials in whole)
    return Length(min(minutes), max(minutes), most, pace.participants)


def find_left(
    plan: Plan, records: Records, *, durations: Durations, pace: Pace
) -> dict[int, float]:
    """Compute the time that is left of a session as its journal leaves it, in s, by the trials that are done."""
    own = SIMULATED if plan.simulated else pace
    agenda, clock_s = replay(plan, records), records.find_elapsed()
    return count_down(plan, durations, own, agenda=agenda, clock_s=clock_s)


def observe_pace(dossiers: Iterable[Dossier], durations: Durations) -> Pace:
    """Measure the pace of a study's real participants; that of simulated ones where there are none yet."""
    spent: dict[str, list[float]] = defaultdict(list)
    pages: list[float] = []
    participants = 0
    for dossier in dossiers:
        plan, records = dossier.plan, dossier.records
        if plan.simulated or not records.has(TrialRated):
            continue
        participants += 1
        least_s = {"break": plan.flow.break_s, "rest": plan.flow.rest_s}
        pages += [max(0.0, p.stood_s - least_s.get(p.key, 0.0)) for p in records.find(PageRead)]
        pages += [answered.stood_s for answered in records.find(QuestionAnswered)]
        # The time of the main trials beyond feeling every part once.
        trials = {trial.number: trial for trial in plan.trials if trial.phase == "main"}
        measure_felt, last_s, shown_s = time_trials(plan, durations), 0.0, 0.0
        for record in records:
            if record.event == TrialShown.event:
                shown_s = last_s
            last_s = record.data.get("time_s", last_s)
            if record.event == TrialRated.event and record.data["trial"] in trials:
                trial = trials[record.data["trial"]]
                took_s, n = max(0.0, last_s - shown_s - measure_felt(trial)), len(trial.judgements)
                spent[trial.protocol] += [took_s / n] * n
    every = [took_s for own in spent.values() for took_s in own]
    if not every:  # nobody has come to the trials that count yet
        return Pace()
    return Pace(
        {protocol: sum(own) / len(own) for protocol, own in spent.items()},
        other_s=sum(every) / len(every),
        page_s=median(pages) if pages else PAGE_S,
        participants=participants,
    )


def read_pace(study: StudyFolder, stimuli: StimulusSet) -> Pace:
    """Read the pace of a study's participants; those who cannot be read are left out."""
    dossiers = []
    for folder in study.participants:
        with suppress(OSError, ValueError):
            dossiers.append(study.read_person(folder))
    return observe_pace(dossiers, find_durations(stimuli))
