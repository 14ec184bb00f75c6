from __future__ import annotations

from feel321.study.people import Progress, describe_rigs, list_remarks


def test_who_is_alone_with_a_rig_or_a_certificate_is_named() -> None:
    everybody = [
        Progress("p01", rig="aa", calibration="c1"),
        Progress("p02", rig="bb", calibration="c9"),
        Progress("p03", rig="aa", calibration="c1"),
        Progress("p04", rig="aa", calibration="uncalibrated", estimated=7),
        Progress("sim001"),
    ]
    assert list(describe_rigs(everybody)) == [
        "p02: another rig (bb) than the other 3 (aa)",
        "p04: another certificate (uncalibrated) than the other 2 (c1)",
        "p04: 7 onset times are estimated from the latency: the device gave none",
    ]


def test_the_report_says_whose_onsets_are_estimates_and_who_gave_up_trials() -> None:
    some = [Progress("p01"), Progress("p02", estimated=7, given_up=3), Progress("p03", estimated=1)]
    assert list(list_remarks(some)) == [
        "Onset times of participants p02 (7), p03 (1) are estimated from the latency: their device gave none.",
        "Trials without a valid answer after all attempts, of participants p02 (3): no ratings.",
    ]
    assert list(list_remarks(some[:1])) == []
