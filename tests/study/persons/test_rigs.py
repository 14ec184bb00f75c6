from __future__ import annotations

import json

from feel321.study.actuator.rig import LimitsTable, Rig, SensorTable, digest, identify
from feel321.study.people import Progress, RigUse, describe_rigs, digest_settings, note_estimates

RIG = Rig(limits=LimitsTable(peak_m_s2=10, rms_m_s2=5, duration_s=3))


def test_the_digest_of_an_identity_is_that_of_the_rig() -> None:
    sensor = SensorTable(channel=1, full_scale_m_s2=160.0)
    own = RIG.model_copy(update={"sensor": sensor})
    assert digest_settings(json.dumps(identify(own))) == digest(own)


def test_who_is_alone_with_a_rig_or_a_certificate_is_named() -> None:
    uses = [
        RigUse("p01", "aa", "c1"),
        RigUse("p02", "bb", "c9"),
        RigUse("p03", "aa", "c1"),
        RigUse("p04", "aa", "uncalibrated", estimated=7),
        RigUse("sim001"),
    ]
    assert list(describe_rigs(uses)) == [
        "p02: another rig (bb) than the other 3 (aa)",
        "p04: another certificate (uncalibrated) than the other 2 (c1)",
        "p04: 7 onset times are estimated from the latency: the device gave none",
    ]


def test_the_report_says_whose_onsets_are_estimates() -> None:
    some = [
        Progress(name, simulated=False, number=1, groups={}, total=2, estimated=n)
        for name, n in (("p01", 0), ("p02", 7), ("p03", 1))
    ]
    assert list(note_estimates(some)) == [
        "Onset times of participants p02 (7), p03 (1) are estimated from the latency: their device gave none."
    ]
    assert list(note_estimates(some[:1])) == []
