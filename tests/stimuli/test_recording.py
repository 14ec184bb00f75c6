from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from feel321.arguments import check_rate
from feel321.stimuli import REDUCERS, psd, spectral_match
from feel321.stimuli.recording import Recording, check_acceleration


def test_samples_are_copied_and_cannot_be_changed() -> None:
    source = np.ones((3, 4))
    recording = Recording(source, rate_hz=100, name="one")
    source[:] = 7.0
    assert np.all(recording.acceleration == 1.0)
    with pytest.raises(ValueError, match="read-only"):
        recording.acceleration[0, 0] = 2.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_counted_and_placed(bad: float) -> None:
    samples = np.zeros((3, 5))
    samples[1, 3] = samples[2, 0] = bad
    with pytest.raises(
        ValueError, match=r"must be finite, got 2 values that are not \(first at 1, 3\)"
    ):
        check_acceleration(samples)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([["a"], ["b"], ["c"]], "real numbers, got values of type <U1"),
        (np.ones((3, 2)) * 1j, "real numbers, got values of type complex128"),
        (np.ones((3, 2), dtype="m8[s]"), "must be real numbers"),
        (np.ma.masked_less(np.arange(6.0).reshape(3, 2), 1), "masked values"),
        ([[1, 2], [3], [4, 5]], "unequal lengths"),
    ],
)
def test_what_is_not_a_table_of_real_numbers_is_refused(values: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_acceleration(values)


@pytest.mark.parametrize("rate", [0, -1, np.nan, np.inf, None, "fast"])
def test_a_rate_is_a_finite_number_above_zero(rate: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        check_rate(rate)


@pytest.mark.parametrize("sha256", ["", "the digest of a file"])
def test_a_copy_with_other_samples_or_another_rate_has_a_digest_of_its_own(sha256: str) -> None:
    samples = np.arange(12.0).reshape(3, 4)
    recording = Recording(samples, 100, "a", sha256=sha256)
    for changes in (
        {"acceleration": 2 * samples},
        {"rate_hz": 101},
        {"acceleration": samples[:, :3]},
    ):
        copy = replace(recording, **changes)
        assert (
            copy.sha256
            == Recording(copy.acceleration, copy.rate_hz, "b").sha256
            != recording.sha256
        )
        assert replace(copy, name="c").sha256 == copy.sha256
        assert (
            replace(copy, acceleration=samples, rate_hz=100).sha256
            == Recording(samples, 100, "b").sha256
        )
        assert replace(recording, **changes, sha256="another file's").sha256 == "another file's"


def test_a_crop_may_end_where_the_recording_ends_but_for_rounding() -> None:
    recording = Recording(np.ones((3, 700)), 1601.57, "a")
    assert recording.crop(0, recording.duration_s * (1 + 1e-12)).n_samples == 700
    with pytest.raises(ValueError, match="0 <= start < end <="):
        recording.crop(0, recording.duration_s * 1.001)


@pytest.mark.parametrize("kind", [np.asarray, pd.DataFrame])
def test_samples_by_axes_are_refused_with_what_to_do(kind: object) -> None:
    turned = kind(np.ones((50, 3)))
    for use in (
        lambda: Recording(turned, 1000.0, "turned"),
        lambda: REDUCERS["dft321"](turned, 1000.0),
        lambda: spectral_match(turned, np.ones(50), 1000.0),
        lambda: psd(turned, rate_hz=1000.0),
    ):
        with pytest.raises(ValueError, match=r"got (the shape )?\(50, 3\); transpose it"):
            use()
