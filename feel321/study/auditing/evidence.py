"""What is kept of a study, beside its journals and elsewhere, against the folder as it is now."""

from collections.abc import Container, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from socket import gethostname

from feel321.study.auditing import anchors
from feel321.study.auditing.checkpoints import CHECKPOINT, find_chain, list_branches, name_chain
from feel321.study.auditing.codes import read_code
from feel321.study.auditing.history import Following, describe_counts
from feel321.study.auditing.keys import name_key
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import Chain, digest, read_chain, read_journal


@dataclass(slots=True)
class Evidence:
    """What the checkpoints and anchors say: findings, remarks, the last anchor, the chains of all, a sentence."""

    findings: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    anchor: anchors.Witness | None = None
    chains: frozenset[str] = frozenset()
    checkpoints: int = 0
    since: str = ""
    sentence: str = ""


def weigh(study: StudyFolder, *, code: str = "", extra: Sequence[Path] = ()) -> Evidence:
    """Compare the folder with its checkpoints, and these with every anchor of it that can be found."""
    own = Evidence()
    if study.is_rehearsal:
        return own
    kept = anchors.read_kept(tuple(extra))
    path, chain, damage = find_chain(study), None, ""
    try:
        chain = read_journal(path) if path.is_file() else None
    except ValueError as error:
        damage = str(error)
    _sort_problems(kept, chain, own)
    is_same = _compare_anchors(study, chain, kept=kept, own=own)
    is_same &= not _find_foreign(study, kept, {str(one) for one in extra}, own=own)
    if code:
        is_same &= _compare_code(chain, code, path=path, own=own)
    copy = None if is_same and chain else _find_copy(kept, own.anchor)
    _follow(study, copy or chain, own)
    if damage:
        place = own.anchor.place if copy and own.anchor else ""
        own.findings.append(f"{damage}; {place} holds one" if place else damage)
    _describe(own, kept, is_known=chain is not None, is_damaged=bool(damage))
    return own


def _sort_problems(kept: anchors.Kept, chain: Chain | None, own: Evidence) -> None:
    """Sort what was wrong with anchors: what is away, or somebody else's, is a remark."""
    names = list_branches(chain.records) if chain else {}
    for one in kept.problems:
        is_remark = "could not be looked at" in one and not any(name in one for name in names)
        (own.remarks if is_remark else own.findings).append(one)


def _follow(study: StudyFolder, chain: Chain | None, own: Evidence) -> None:
    """Follow the history, from the copy of the chain where the study's own is not the one that was anchored."""
    if chain is None or not name_chain(chain.records):
        return
    own.checkpoints = sum(one.event == CHECKPOINT for one in chain.records)
    lines = own.anchor.lines if own.anchor else len(chain.records)
    history = Following(study, lines)
    try:
        history.follow(chain.records)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        own.findings.append(
            f"{find_chain(study)}: holds what feel321 does not write ({error!r}); restore it from a copy"
        )
        return
    own.findings += history.findings
    own.remarks += history.remarks
    own.since = describe_counts(history.counts)


def _compare_anchors(
    study: StudyFolder, chain: Chain | None, *, kept: anchors.Kept, own: Evidence
) -> bool:
    """Check that every anchor of this study is on its chain; the newest is remembered."""
    path = find_chain(study)
    lines = anchors.read_lines(path).split(b"\n")[:-1] if path.is_file() else []
    branches = list_branches(chain.records) if chain else {}
    ours = [
        one for one in kept.witnesses if one.chain in branches or (not chain and _names(one, lines))
    ]
    others = [
        one
        for one in kept.witnesses
        if one not in ours and _is_here(one, study, is_gone=chain is None)
    ]
    own.chains = frozenset(one.chain for one in (*ours, *others))
    away = [one for one in ours if _is_away(one, study, branches)]
    for one in away[:1]:
        own.remarks.append(
            f"{path}: went on in another folder, too, {one.host}:{one.folder}, anchored at {one.utc}"
        )
    ours = [one for one in ours if one not in away]
    wrong = [one for one in ours if not _is_on(one, lines)]
    for one in wrong[:1]:
        what = (
            f"line {one.lines} is not"
            if len(lines) >= one.lines
            else f"ends with line {len(lines)}; line {one.lines} is"
        )
        own.findings.append(
            f"{path}: {what} the one anchored in {one.place} at {one.utc}; restore it from a copy"
        )
    for one in others[:1]:
        became = "is another chain than the one" if path.is_file() else "is gone, it was"
        own.findings.append(
            f"{path}: {became} anchored of this folder in {one.place} at {one.utc}; restore it from a copy, or, if "
            "this is a different study, rename its folder"
        )
    own.anchor = max([*others, *wrong] or ours, key=lambda one: (one.utc, one.lines), default=None)
    _note_keys(ours, own)
    return not (wrong or others)


def _find_foreign(
    study: StudyFolder, kept: anchors.Kept, given: Container[str], *, own: Evidence
) -> bool:
    """Find out whether there are anchors, but none of this chain; of those that were given, one must be."""
    those = [one for one in kept.witnesses if one.place in given]
    foreign = those or list(kept.witnesses)
    if not foreign or any(one.chain in own.chains for one in foreign):
        return False
    count, newest = len({one.chain for one in foreign}), max(foreign, key=lambda one: one.utc)
    text = (
        f"{find_chain(study)}: no anchor of this chain is in {newest.place}, which has those of {count} other "
        f"chain{'s' * (count != 1)} (the newest of {newest.host}:{newest.folder}, {newest.utc})"
    )
    if not those:
        own.remarks.append(f"{text}; if there was one, the study was moved and made anew")
        return False
    own.findings.append(f"{text}; the study was made anew, or the anchors are of another one")
    same = [one for one in those if count == 1 or Path(one.folder).name == study.path.name]
    if len({one.chain for one in same}) == 1:
        own.anchor = max(same, key=lambda one: (one.utc, one.lines))
    return True


def _is_away(one: anchors.Witness, study: StudyFolder, branches: dict[str, int]) -> bool:
    """Check whether an anchor is of a copy of this study that went on elsewhere."""
    is_last = one.chain == next(reversed(branches), one.chain)
    is_here = one.folder == str(study.path.absolute())
    return not (is_last or is_here) and one.lines > branches.get(one.chain, one.lines)


def _names(one: anchors.Witness, lines: Sequence[bytes]) -> bool:
    """Check whether a chain that cannot be read is the one of an anchor."""
    return any(one.chain.encode() in line for line in lines[:2])


def _is_on(one: anchors.Witness, lines: Sequence[bytes]) -> bool:
    return 0 < one.lines <= len(lines) and digest(lines[one.lines - 1]) == one.sha256


def _is_here(one: anchors.Witness, study: StudyFolder, *, is_gone: bool) -> bool:
    """Check whether an anchor is of another chain in this folder; one that was moved is known by its last name."""
    here = study.path.absolute()
    if one.folder == str(here):
        return True
    is_begun = study.participants or study.ledger_log.exists() or study.ledger.exists()
    is_begun = is_begun or (study.path / "participants.csv").exists()
    return bool(is_gone and is_begun and Path(one.folder).name == here.name)


def _note_keys(ours: Sequence[anchors.Witness], own: Evidence) -> None:
    """Note who signed; what this rig put there since it has a key must be signed with that."""
    public, since = anchors.read_public()
    here = [one for one in ours if since and one.host == gethostname() and one.utc >= since]
    for one in [one for one in here if one.key != public][:1]:
        own.findings.append(
            f"{one.place}: the anchor of {one.utc} is {_describe_key(one)}; this rig signs with {name_key(public)} "
            f"since {since}, so the anchor was changed, or put there by somebody else"
        )
    signed = {name_key(one.key): f"{one.host}" for one in ours if one.key}
    if len(signed) > 1:
        named = ", ".join(f"{key} ({host})" for key, host in signed.items())
        own.remarks.append(
            f"anchors were signed with several keys: {named}; check that all belong to your rigs"
        )


def _describe_key(one: anchors.Witness) -> str:
    return f"signed by {name_key(one.key)} ({one.host})" if one.key else "not signed"


def _compare_code(chain: Chain | None, code: str, *, path: Path, own: Evidence) -> bool:
    lines, prefix = read_code(code)
    content = anchors.read_lines(path).split(b"\n")[:-1] if chain else []
    if 0 < lines <= len(content) and digest(content[lines - 1]).startswith(prefix):
        if own.anchor is None and chain:
            utc = chain.records[lines - 1].utc
            own.anchor = anchors.Witness("", lines, "", utc, "", "", place="the printed code")
        return True
    own.findings.append(
        f"{path}: line {lines} is not the one of the code {code}; the checkpoints were written anew"
    )
    return False


def _find_copy(kept: anchors.Kept, anchor: anchors.Witness | None) -> Chain | None:
    """Find the copy of the chain that an anchor is of, up to there."""
    for name, path in kept.copies:
        if anchor is None or name != anchor.chain or not path.is_file():
            continue
        lines = anchors.read_lines(path).split(b"\n")[: anchor.lines]
        if not _is_on(anchor, lines):
            continue
        try:
            return read_chain(b"".join(line + b"\n" for line in lines), str(path))
        except ValueError:
            continue
    return None


def _describe(own: Evidence, kept: anchors.Kept, *, is_known: bool, is_damaged: bool) -> None:
    """Say in one sentence how far the evidence reaches."""
    looked = (
        ", ".join(kept.places) or "no place outside the folder was chosen: feel321 seal --to DIR"
    )
    after = f"{own.since or 'nothing was recorded'} after it"
    if own.anchor is not None:
        verb = "compared with" if own.findings else "nothing was changed since"
        one = own.anchor
        of = f" (checkpoint of {one.checkpoint_utc}, {_describe_key(one)})" if one.chain else ""
        own.sentence = f"{verb} the anchor of {one.utc} in {one.place}{of}; {after}"
    elif is_known:
        count = f"{own.checkpoints} checkpoint{'s' * (own.checkpoints != 1)} in the folder itself"
        since = f", {own.since} after the last" if own.since else ""
        own.sentence = f"compared with {count}{since}; anchors: none ({looked})"
    else:
        state = "the checkpoints cannot be read" if is_damaged else "no checkpoints were kept"
        own.sentence = f"{state}; anchors: none ({looked})"
