"""The day in the lab, in some ten minutes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

DAY = Path(__file__).with_name("lab_day.py")


@pytest.mark.soak
def test_a_day_in_the_lab_loses_nothing() -> None:
    command = [sys.executable, DAY, "--hours", "8", "--speed", "60", "--repeats", "10"]
    done = subprocess.run(command, text=True, capture_output=True, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
