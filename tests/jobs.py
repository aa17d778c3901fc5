"""What the processes of test_jobs.py do; run as a program: waits with two of them for its end."""

import os
import signal
import sys
import time
from functools import partial

from swe_sphere.errors import ConfigError
from swe_sphere.studies.jobs import in_processes

LONG = 600.0
"""Seconds that no test waits for."""


def die():
    """Kill this process; the signal may arrive late."""
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(LONG)


class Deadly:
    """Kills the process that sends it."""

    def __reduce__(self):
        die()


def squaring(power):
    def work(number):
        if number == "raise":
            raise ConfigError("no number")
        if number == "break":
            raise ValueError("what\na pity")
        if number == "die":
            die()
        if number == "die sending":
            return ("x" * 2**24, Deadly())
        if number == "wait":
            time.sleep(LONG)
        if number == "pid":
            time.sleep(1.0)  # so that the other process takes the next task
            return os.getpid()
        return number, number**power

    return work


if __name__ == "__main__":
    from jobs import squaring as known_by_name

    for pid in in_processes(2, partial(known_by_name, 2), ["pid", "pid", "wait", "wait"]):
        sys.stdout.write(f"{pid}\n")
        sys.stdout.flush()
