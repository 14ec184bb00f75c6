from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.analysis.standard import compare_dependent


def test_zou_2007_overlapping_example() -> None:
    result = compare_dependent(0.396, 0.179, 0.088, 66)
    assert (round(result.zou_low, 3), round(result.zou_high, 3)) == (-0.093, 0.517)


def test_steiger_1980_case_a() -> None:
    # Psychological Bulletin 87, 245-251; R's psych 2.2.9 prints the same: r.test(n = 103, .4, .5, .1)
    result = compare_dependent(0.4, 0.5, 0.1, 103)
    assert result.williams_t == pytest.approx(-0.8912799, abs=1e-7)
    assert result.williams_p == pytest.approx(0.3749185, abs=1e-7)
    assert result.steiger_z == pytest.approx(-0.89, abs=0.005)


def test_williams_of_psych() -> None:
    result = compare_dependent(0.9, -0.2, -0.3, 12)
    assert (result.williams_t, result.williams_p) == pytest.approx(
        (3.702096, 0.004904615), abs=1e-6
    )
    result = compare_dependent(0.396, 0.179, 0.088, 66)
    assert (result.williams_t, result.williams_p) == pytest.approx((1.380949, 0.1721738), abs=1e-6)
    # r.test(n = 103, r12 = .5, r13 = .4, r23 = .3) and so on, psych 2.2.9
    for arguments, printed in (
        ((0.5, 0.4, 0.3, 103), (0.996900779735, 0.321218841518)),
        ((-0.3, 0.2, 0.1, 50), (-2.75917119688663, 0.00823268299379)),
        ((0.9, 0.7, 0.8, 20), (2.95071533320257, 0.00894579777683)),
    ):
        result = compare_dependent(*arguments)
        assert (result.williams_t, result.williams_p) == pytest.approx(printed, rel=1e-9)


def test_meng_1992_example() -> None:
    assert compare_dependent(0.63, -0.03, -0.19, 15).meng_z == pytest.approx(1.68, abs=0.005)


def test_cocor_output() -> None:
    """What cocor 1.1 (doi 10.1371/journal.pone.0121945) prints in the documentation of R's rmcorr."""
    result = compare_dependent(0.8065821, 0.2383, 0.2255, 177)
    printed = {
        "williams_t": 9.3823,
        "steiger_z": 8.5460,
        "meng_z": 8.3907,
        "zou_low": 0.4288,
        "zou_high": 0.7139,
    }
    assert {name: getattr(result, name) for name in printed} == pytest.approx(printed, abs=3e-4)
    assert result.williams_df == 174


correlations = st.floats(-0.95, 0.95)


@settings(deadline=None)  # the first call imports scipy.stats
@given(r_jk=correlations, r_jh=correlations, r_kh=correlations, n=st.integers(4, 500))
def test_exchange_turns_every_sign(r_jk: float, r_jh: float, r_kh: float, n: int) -> None:
    if 1 - r_jk**2 - r_jh**2 - r_kh**2 + 2 * r_jk * r_jh * r_kh < 0:
        return
    there, back = compare_dependent(r_jk, r_jh, r_kh, n), compare_dependent(r_jh, r_jk, r_kh, n)
    for name in ("williams_t", "steiger_z", "meng_z", "difference"):
        assert getattr(there, name) == pytest.approx(-getattr(back, name), nan_ok=True)
    assert there.zou_low == pytest.approx(-back.zou_high)
    assert there.zou_low <= there.difference <= there.zou_high


def test_independent_items_hold_the_size() -> None:
    """Where its model is true, each test is: 5 % of trivariate normal samples with equal correlations."""
    rng = np.random.default_rng(2)
    corr = np.array([[1, 0.5, 0.5], [0.5, 1, 0.6], [0.5, 0.6, 1]])
    hits = np.zeros(4)
    for _ in range(600):
        r = np.corrcoef(rng.multivariate_normal(np.zeros(3), corr, 40).T)
        result = compare_dependent(r[0, 1], r[0, 2], r[1, 2], 40)
        p = np.array([result.williams_p, result.steiger_p, result.meng_p])
        hits += np.append(p < 0.05, not result.zou_low <= 0 <= result.zou_high)
    assert ((hits / 600 > 0.025) & (hits / 600 < 0.08)).all()


@pytest.mark.parametrize("place", range(3))
def test_a_correlation_that_is_missing_is_refused(place: int) -> None:
    values = [0.5, 0.3, 0.4]
    values[place] = float("nan")
    with pytest.raises(ValueError, match="r_jk, r_jh and r_kh must be -1 to 1"):
        compare_dependent(*values, 40)
