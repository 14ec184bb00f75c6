"""Every mistake in `study.toml` is one line that says where it is, what was found and what is allowed."""

import re
from pathlib import Path

import pytest

from feel321.study.settings.read import find_conflicts, read_settings

SHORTEST = '[[recordings]]\nscene = "bumps"\n'
TWO = '[[recordings]]\nscene = "bumps"\nsample = "ridges"\n[[recordings]]\nscene = "hard_taps"\n'
ASK = "[[session.questions]]; name = 'q'; question = 'What?'; "
ROUGH = "[scales.roughness]; question = 'How rough?'; low = 'smooth'; high = 'rough'; "
CLAIM = (
    "[paper]; citation = 'a'; doi = 'b'; seen = 'abstract'; "
    "[[paper.claims]]; name = 'a'; claim = 'b'; source = 'ours'; "
)
TEN = list("abcdefghij")

WHOLE = (
    ("", "recordings: missing; add it"),
    ("recordings = []", "recordings must hold at least one name, got []"),
    ("a = ", "not valid TOML (Invalid value"),
    (SHORTEST * 2, "recordings must hold each name once"),
    (SHORTEST + f"name = '{'a' * 101}'", "must be up to 100 letters"),
    (SHORTEST * 2 + "name = 'Bumps'", "recordings: recording name 'Bumps' is there twice"),
    ("[[recordings]]; scene = 'bumsp'", "recordings[1].scene must be one of bumps, texture_drag,"),
    ("[[recordings]]; file = 'a'; unit = 'kg'", "recordings[1].unit must be one of m/s^2, g, mg"),
    ("a = " + "[" * 99999, "nested too deeply; use fewer levels"),
    (f"[{'.'.join('a' * 3000)}]", "nested too deeply; use fewer levels"),
    (SHORTEST + f"[between]; a = {TEN}; b = {TEN}", "at most 64 groups, got 100; use fewer"),
)  # fmt: skip
"""Whole files, with ; between their lines."""

ADDED = (
    ("[stimli]", "stimli: unknown setting; did you mean stimuli?"),
    ("[rig]; zzz = 1", "rig.zzz: unknown setting; known: rate_hz, full_scale_m_s2, headroom"),
    ("unit = 'g'", "recordings[1]: unit does not go with scene; leave it out"),
    ("[[recordings]]; file = 'a'; unti = 'g'", "recordings[2].unti: unknown setting; did you mean"),
    ("[[recordings]]; name = 'a'", "recordings[2] must have one of scene, file, files, got none"),
    ("name = 'a/b'", "recordings: a recording's name must be up to 100 letters"),
    ("[stimuli]; reducers = ['dft3211']", "stimuli.reducers[1] must be one of sax321, say321"),
    ("[session]; protocols = ['realism', 'realism']", "more than once: realism"),
    ("[stimuli]; levels = []", "stimuli.levels must hold at least one name, got []"),
    ("[stimuli]; reference = 'x'", "stimuli.reference must be one of original, none, sax321"),
    ("[stimuli]; gain = 1e300", 'stimuli.gain must be "set", "per_recording", or a number from'),
    ("[session]; language = 'xx'", "session.language must be one of de, en, or a file beside"),
    ("[session]; consent = ' '", "session.consent must not be empty, got ' '"),
    ("[session.rehersal]", "session.rehersal: unknown setting; did you mean rehearsal?"),
    ("[session.breaks]; every_trials = 0", 'must be greater than or equal to 1 or "off", got 0'),
    ("[session.breaks]; every_min = 'never'", "must be a valid number or \"off\", got 'never'"),
    ("[session.quality]; reject = ['late']", "reject[1] must be one of underrun, clipped,"),
    ("[tasks.mushr]", "tasks.mushr must be one of realism, similarity,"),
    ("[tasks.abx]; timming = 'strict'", "tasks.abx.timming: unknown setting; did you mean timing?"),
    ("[tasks]; abx = 3", "tasks.abx must be a table, got 3"),
    ("[observer]; lapse_rate = 2", "observer.lapse_rate must be less than or equal to 1, got 2"),
    ("[observer]; random_clickers = 0.6; scale_reversers = 0.6", "observer: straight_liners, rand"),
    ("[session]; repeats = 1001", "session.repeats must be less than or equal to 1000, got 1001"),
    ("[study]; seed = '5'", "study.seed must be a valid integer, got '5'"),
    ("[study]; name = 2026-01-01", "got the date or time 2026-01-01; put it in quotes"),
    ("[between]; Levels = ['as_is']", "between.Levels must be 'level' or a label"),
    ("[between]; 'my grip' = ['a']", "between.my grip must be up to 40 letters"),
    ("[between]; Rating = ['a']", "Rating must not be a column of participants.csv or ratings.csv"),
    ("[stations]; this = 3; of = 2", "stations: this must be 1 to 2, got 3"),
    ("[publication]; released = 'May'", "publication.released must be a day such as '2026-11-23'"),
    ("[[session.questions]]; name = 'q'; kind = 'text'", "session.questions[1].question: missing; add"),
    (f"{ASK}kind = 'text'; personel = true", "questions[1].personel: unknown setting; did you mean p"),
    (f"{ASK}kind = 'choise'", "session.questions[1].kind must be one of choice, number, text, l"),
    (f"{ASK}kind = 'choice'", "session.questions[1]: options must be 2 to 9 texts for kind"),
    (f"{ASK}kind = 'text'; high = 3", "low and high must not be numbers for kind 'text'"),
    (f"{ASK}kind = 'number'; low = 'never'", "session.questions[1].low must be a valid number"),
    (f"{ASK}kind = 'text'; {ASK}kind = 'text'", "must hold each name once; more than once: q"),
    (f"{ROUGH}[tasks.realism]; scales = ['realism', 'roughnes']", "did you mean 'roughness'? Or"),
    (f"{ROUGH}[tasks.realism]; scales = ['roughness']", "tasks.realism.scales must hold 'realism'"),
    (f"{ROUGH}[tasks.abx]; scales = ['abx', 'roughness']", "tasks.abx.scales must be left out"),
    ("[scales.abx]; question = 'a'; low = 'b'; high = 'c'", "scales.abx: must not be set"),
    ("[scales.rough]; question = 'a'; low = 'b'; high = 'b'", "low and high must differ, got 'b'"),
    ("[tasks.realism]; gap_s = 40", "tasks.realism.gap_s must be 0 to 30, got 40"),
    ("[tasks.mushra]; onset_s = 9", "tasks.mushra.onset_s must not be set: parts are felt at"),
    (f"{CLAIM}measure = 'slope'; expect = 'near'", "must give the paper's low and high"),
    (f"{CLAIM}measure = 'slop'", "did you mean 'slope'"),
    (f"{CLAIM}measure = 'slope'; options = {{ recordng = 'r1' }}", "did you mean 'recording'?"),
    (
        f"{CLAIM}measure = 'slope'; options = {{ among = 'mag321' }}",
        "options.among must be a list of names, got 'mag321'",
    ),
    ("[session.stale]; policy = 'wait'", "session.stale.policy must be one of warm_up, continue,"),
    ("[session.stale]; after_h = 'never'", 'after_h must be a valid number or "off", got'),
    ("[stimuli.conditioning]; low_pass = 9.0", "conditioning.low_pass: unknown setting; did you mean"),
    ("[stimuli.conditioning]; low_pass_hz = 9.0", "high_pass_hz must be below low_pass_hz, 9.0; got"),
    (f"{CLAIM}measure = 'slope'; paper = {{}}", "paper must have a value, or low and high, got none"),
    (f"{CLAIM}measure = 'slope'; exceptions = ['a', 'a']", "exceptions must be different names"),
    (f"{CLAIM}measure = 'slope'; exceptions = ['']", "exceptions must be different names"),
    (f"{CLAIM}measure = 'slope'; options = {{ scale = '' }}", "options.scale must not be empty"),
    (f"{CLAIM}measure = 'slope'; options = {{ among = [''] }}", "options.among must not be empty"),
    (f"{CLAIM}measure = 'slope'; options = {{ scale = 1 }}", "options.scale must be a valid string, got 1"),
    (f"{CLAIM}measure = 'slope'; paper = {{ value = 0.5, low = 0.6, high = 0.8 }}", "in that order"),
)  # fmt: skip
"""What is added to the shortest study, with ; between its lines, and what is said of it."""

TOGETHER = (
    ("[tasks.mushra]; timing = 'strict'", "tasks.mushra.timing must be one of free; got 'strict'"),
    ("[tasks.realism]; reference = 'original'", "tasks.realism.reference must not be set, got 'o"),
    ("[tasks.abx]; surface = true", "tasks.abx.surface must be false, got true"),
    ("[tasks.realism]; surface = true", "recordings[2].sample: missing, but participants touch"),
    ("[reducers.dft321]; command = './mine {input} {output}'", "reducers.dft321: the name is taken"),
    ("[metrics.st_sim]; use = 'mylab:st_sim'", "metrics.st_sim: the name is taken by one of"),
    ("[metrics.level_difference]; higher = 'better'", "metrics.level_difference.higher must be 'w"),
    ("[stimuli]; metrics = ['temporal_match']", "stimuli.metrics[1] must be a further metric"),
    ("[stimuli]; metrics = ['st_sym']", "stimuli.metrics[1] must be one of"),
    ("[stimuli]; reference = 'dft321'", "stimuli.reference must not be one of stimuli.reducers too"),
    ("[session.matching]; level = 'equal_intensity'", "session.matching.level must be one of"),
    ("[session]; repeats = 400", "a session must have at most 10000 trials, got 19200 with"),
    ("[session]; recordings_per_participant = 3", "session.recordings_per_participant must be at"),
    ("[between]; level = ['equal_intensity']", "between.level must be one of as_is, got 'equal_in"),
    ("[between]; protocol = ['abx']", "between.protocol must be one of realism, similarity, got"),
    ("[tasks.similarity]; reference = 'dft'", "tasks.similarity: recording 'bumps', level 'as_is'"),
    ("[stimuli]; reference = 'none'", "tasks.similarity: recording 'bumps', level 'as_is' must have"),
)  # fmt: skip
"""What is allowed by itself, but not together."""

FINE = (
    "",
    "[session]; protocols = ['realism', 'similarity', 'dissimilarity', 'mushra', 'abx']",
    "[stimuli]; reference = 'none'; [session]; protocols = ['realism']",
    "[stimuli]; reference = 'none'; [between]; protocol = ['realism']",
    "[tasks.similarity]; reference = 'dft321'",
    "[metrics.level_difference]; label = 'level'; higher = 'worse'",
    # A task that no session has may be set to anything its protocol knows.
    "[tasks.mushra]; timing = 'free'; [session]; protocols = ['realism']",
    "[stimuli]; levels = ['as_is', 'equal_intensity']; [between]; level = ['as_is', 'equal_intensity']",
    "[between]; protocol = ['realism', 'similarity']; grip = ['pen', 'mit Öl']",
    "[observer]; straight_liners = 0.5; scale_reversers = 0.5",
    "[stimuli]; reference = 'dft321'; reducers = ['sax321']",
    # Each participant has one of the tasks, and the limit is on sessions.
    "[session]; repeats = 400; [between]; protocol = ['realism', 'similarity']",
)


def tell(folder: Path, text: str) -> list[str]:
    """Say what reading the settings says, one entry per line."""
    (folder / "study.toml").write_text(text.replace("; ", "\n"), encoding="utf-8")
    try:
        assert find_conflicts(read_settings(folder / "study.toml")) == []
    except ValueError as error:
        return str(error).splitlines()
    return []


@pytest.mark.parametrize(
    ("text", "message"),
    [*WHOLE, *((SHORTEST + a, m) for a, m in ADDED), *((TWO + a, m) for a, m in TOGETHER)],
)
def test_every_mistake_has_its_line(text: str, message: str, tmp_path: Path) -> None:
    (line,) = tell(tmp_path, text)
    assert message in line


@pytest.mark.parametrize("text", FINE)
def test_settings_that_go_together_pass(text: str, tmp_path: Path) -> None:
    assert tell(tmp_path, TWO + text) == []


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    told = tell(tmp_path, SHORTEST + "[rig]; zzz = 1; headroom = 2; [study]; seed = 'a'")
    assert [line.split()[1].strip(":") for line in told] == [
        "study.seed",
        "rig.headroom",
        "rig.zzz",
    ]


def test_what_follows_from_a_conflict_is_not_told_as_well(tmp_path: Path) -> None:
    text = (
        "[tasks.realism]; timing = 'free'; surface = true; [tasks.mushra]; reference = 'surface'; "
        "[between]; level = ['as_is', 'equal_intensity']; protocol = ['abx', 'mushra']"
    )
    assert [re.split(r"[: ]", line)[2] for line in tell(tmp_path, TWO + text)] == [
        "tasks.realism.timing",
        "tasks.mushra.reference",
        "between.level",
        "between.protocol",
        "between.protocol",
    ]
