"""The agenda of a session: training, practice, trials and pages, and what comes next.

Pages, training with feedback, practice, breaks, and repeated attempts all follow from the plan and from what was
told so far, and from nothing else. A session that is resumed therefore tells an agenda what its journal holds, and
goes on as if it had never been interrupted.

A round of training is passed if, of those answers that are not right by guessing, the share that was asked for is
right (correction for guessing: Macmillan & Creelman 2005, chapter 4). At 75 % that lets nobody miss one of four, and
one of eight where the choice is between two.
"""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from itertools import groupby

from feel321.protocols import trial as nouns
from feel321.protocols.tasks import measure_chance
from feel321.protocols.texts import Question, list_pages
from feel321.protocols.trial import LOST, MATCHING, SPOILED, THRESHOLD, VALID, Flow, Page, Trial

SECONDS = 60.0
# Pages after which the time to the next break starts anew, and phases whose answers are results.
RELAXING = frozenset({"main", "break", "rest", "warm_up", "threshold_done", "matching_done"})
COUNTED = frozenset({"main", THRESHOLD, MATCHING})


class Agenda:
    """The steps of a session that are still to be done, in order.

    total: trials of the main phase; answered: those that have an answer that counts; given_up: those that were tried
    too often without; lost_in_a_row: attempts at trials that the device lost, up to now.

    >>> agenda = Agenda([], Flow())
    >>> agenda.tell_page(agenda.ask().key, time_s=2.5)
    >>> agenda.ask()
    Page(key='consent', least_s=0.0, by='participant')
    """

    def __init__(
        self, trials: Sequence[Trial], flow: Flow, questions: Sequence[Question] = ()
    ) -> None:
        self.flow = flow
        self._trials = {trial.number: trial for trial in trials}
        self._steps: deque[Page | Trial] = deque(_list_steps(trials, flow, questions))
        self._failed: Counter[tuple[int, str]] = Counter()
        self._rounds: Counter[str] = Counter()
        self._understood: list[bool] = []
        self._guessed = 0.0
        self._since_break, self._break_s = 0, 0.0
        self.total = sum(trial.phase == "main" for trial in trials)
        self.answered = self.given_up = self.lost_in_a_row = 0

    @property
    def done(self) -> int:
        """Trials of the main phase that need no further attempt."""
        return self.answered + self.given_up

    def ask(self) -> Page | Trial | None:
        """Return the next step, the same one until it is told as done; None when all are."""
        return self._steps[0] if self._steps else None

    def attempt(self, number: int) -> int:
        """Return the number of the next attempt at a trial, from 1."""
        return self._failed[number, LOST] + self._failed[number, SPOILED] + 1

    def tell_page(self, key: str, *, time_s: float) -> None:
        """Take a page as read at a time in s since the session began; the pages `ASIDE` may be read at any time."""
        if key in nouns.ASIDE:
            return
        self._take(key)
        if key in RELAXING:
            self._since_break, self._break_s = 0, time_s

    def tell_trial(
        self, number: int, outcome: str, *, as_expected: bool | None, time_s: float
    ) -> None:
        """Take an attempt as made; if not `VALID` it comes again, up to a limit. as_expected: None if any will do."""
        self._take(number)
        trial = self._trials[number]
        self.lost_in_a_row = self.lost_in_a_row + 1 if outcome == LOST else 0
        if outcome != VALID:
            self._failed[number, outcome] += 1
            most = nouns.MOST_LOST if outcome == LOST else self.flow.max_attempts
            if self._failed[number, outcome] < most:
                # Behind what is left of its block, else of its section, else at once.
                left = [(n, t) for n, t in enumerate(self._steps, 1) if isinstance(t, Trial)]
                own = (trial.phase, trial.protocol)
                section = [(n, t.block) for n, t in left if (t.phase, t.protocol) == own]
                block = [n for n, block in section if block == trial.block]
                self._steps.insert(max(block or [n for n, _ in section], default=0), trial)
                return
        if trial.phase == "training":
            self._put_first(list(self._teach(trial, understood=as_expected)))
        elif trial.phase == "main":
            self.answered += outcome == VALID
            self.given_up += outcome != VALID
            self._since_break += 1
            trials, minutes = self.flow.break_trials, self.flow.break_min
            by_count = trials is not None and self._since_break >= trials
            by_time = minutes is not None and time_s - self._break_s >= minutes * SECONDS
            # Where a page comes anyway, or nothing does, a break would be one too many.
            if (by_count or by_time) and isinstance(self.ask(), Trial):
                self._steps.appendleft(Page("break", self.flow.break_s))

    def warm_up(self) -> None:
        """Repeat the practice trials of the current task when a participant returns after a long break."""
        ahead = next((step for step in self._steps if isinstance(step, Trial)), None)
        if ahead is None or ahead.phase not in COUNTED or self._steps[0] == Page("warm_up"):
            return  # Nothing is left, or the warm-up is under way.
        if again := self._find_trials("practice", ahead.protocol):
            self._put_first([Page("warm_up"), *again])

    def _find_trials(self, phase: str, protocol: str) -> list[Trial]:
        own = (phase, protocol)
        return [one for one in self._trials.values() if (one.phase, one.protocol) == own]

    def _take(self, name: str | int) -> None:
        step = self.ask()
        expected = step.key if isinstance(step, Page) else step.number if step else None
        if name != expected:
            got, wanted = (
                f"trial {key}" if isinstance(key, int) else f"page {key!r}" if key else "the end"
                for key in (name, expected)
            )
            raise ValueError(f"got {got}, expected {wanted}")
        self._steps.popleft()

    def _teach(self, trial: Trial, *, understood: bool | None) -> Iterator[Page | Trial]:
        """Give feedback on an answer of training; after the last of a round its result, or another round."""
        if understood is not None:
            self._understood.append(understood)
            self._guessed += measure_chance(trial)
            yield Page("expected" if understood else "unexpected")
        training = self._find_trials("training", trial.protocol)
        numbers = {one.number for one in training}
        left = (step for step in self._steps if isinstance(step, Trial))
        if not self._understood or any(step.number in numbers for step in left):
            return
        needed = self.flow.training_pass * (len(self._understood) - self._guessed)
        self._rounds[trial.protocol] += 1
        if max(sum(self._understood) - self._guessed, 0.0) >= needed:
            yield Page("training_passed")
        elif self._rounds[trial.protocol] >= self.flow.training_rounds:
            yield Page("training_failed", by="experimenter")
        else:
            yield Page("training_again")
            yield from training
        self._understood, self._guessed = [], 0.0

    def _put_first(self, steps: Sequence[Page | Trial]) -> None:
        """Put steps before all others; a trial that comes again has all its attempts again."""
        for step in steps:
            if isinstance(step, Trial):
                self._failed[step.number, LOST] = self._failed[step.number, SPOILED] = 0
        self._steps.extendleft(reversed(steps))


def _list_steps(
    trials: Sequence[Trial], flow: Flow, questions: Sequence[Question]
) -> Iterator[Page | Trial]:
    """List the steps of a session in which nothing goes wrong and no break is due."""
    yield from (Page("welcome"), Page("consent"), *list_pages(questions, "before"))
    for protocol in (THRESHOLD, MATCHING):
        if own := [trial for trial in trials if trial.protocol == protocol]:
            yield from (Page(f"instructions.{protocol}"), *_list_rehearsal(own, "practice"))
            counted = (trial for trial in own if trial.phase == protocol)
            # One part after the other (frequencies).
            for place, (_, part) in enumerate(groupby(counted, key=lambda trial: trial.block)):
                yield Page("threshold_next", flow.break_s) if place else Page("main")
                yield from part
            yield Page(f"{protocol}_done", flow.rest_s)
    main = [trial for trial in trials if trial.phase == "main"]
    sections = [list(section) for _, section in groupby(main, key=lambda trial: trial.protocol)]
    rest = (*list_pages(questions, "between"), Page("rest", flow.rest_s))
    for place, section in enumerate(sections):
        if place:
            yield from rest
        yield Page(f"instructions.{section[0].protocol}")
        own = [trial for trial in trials if trial.protocol == section[0].protocol]
        yield from (*_list_rehearsal(own, "training"), *_list_rehearsal(own, "practice"))
        half = (len(section) + 1) // 2 if len(sections) == 1 else len(section)
        yield Page("main")
        yield from section[:half]
        if section[half:]:
            yield from rest
            yield from section[half:]
    yield from (*list_pages(questions, "after"), Page("end"))


def _list_rehearsal(trials: Sequence[Trial], phase: str) -> list[Page | Trial]:
    """List the training or practice among trials, after its page."""
    own = [trial for trial in trials if trial.phase == phase]
    return [Page(phase), *own] if own else []
