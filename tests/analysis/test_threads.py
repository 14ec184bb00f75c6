"""Fits in several threads leave the process's linear algebra with the threads it had."""

import os
import subprocess
import sys

COUNT = """
import scipy.linalg
from concurrent.futures import ThreadPoolExecutor
from threadpoolctl import threadpool_info
from feel321.analysis.mixed.model import fit_mixed

def count():
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

before = count()
"""

POOL = """
import pandas as pd
data = pd.DataFrame({"who": list("aaabbbcccddd"), "x": [0, 1, 2] * 4, "y": [1.0, 2, 4, 3, 5, 6, 2, 2, 4, 5, 7, 8]})
with ThreadPoolExecutor(4) as pool:
    found = set(pool.map(lambda _: fit_mixed("y ~ x + (1 | who)", data).criterion, range(12)))
print(before, count(), len(found), sep=";")
"""


def run_apart(code: str) -> list[str]:
    """Run in a process of its own, where linear algebra has two threads and nobody else limits them."""
    told = dict(os.environ, OPENBLAS_NUM_THREADS="2", MKL_NUM_THREADS="2", OMP_NUM_THREADS="2")
    done = subprocess.run(
        [sys.executable, "-c", COUNT + code], env=told, check=True, capture_output=True, text=True
    )
    return done.stdout.strip().split(";")


def test_fits_in_a_pool_agree_and_leave_the_threads_as_they_were() -> None:
    before, after, different = run_apart(POOL)
    assert after == before
    assert different == "1"
