"""Runs of one model in a separate process; requests and answers are lines of JSON.

A request has the keys of `Case` except the fields on the grid, which are in the file "fields", and
the keys "steps" and "out", the file for the final free surface.  The answer contains CPU and wall
time of the steps [s], without set-up, compilation and two steps before the timed ones.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from types import SimpleNamespace as Case
from typing import Any, Protocol

import numpy as np


class Model(Protocol):
    """A model that is set up for a case.

    The case has lat (M,), lon (K,) [rad], the initial u, v [m s-1], depth h and bottom b [m] on
    (M, K), radius [m], rotation [s-1], gravity [m s-2], truncation (the highest degree), stepper
    and dt [s].
    """

    def start(self, steps: int) -> Any:
        """Return the initial state, prepared for a number of steps."""

    def run(self, state: Any, steps: int) -> Any:
        """Return the state after these steps; this call is timed."""

    def surface(self, state: Any) -> np.ndarray:
        """Return the free surface [m] at lat, lon: (M, K)."""


def answer(model: Callable[[Case], Model], version: str) -> None:
    """Answer requests from standard input until it ends; the first line of answers is the version.

    Answers go to the file descriptor named on the command line, because libraries print to stdout.
    """
    replies = os.fdopen(int(sys.argv[1]), "w")
    _say(replies, {"version": version})
    ready: dict[str, Model] = {}
    for line in sys.stdin:
        request = json.loads(line)
        try:  # other settings go on, whatever is wrong with one
            _say(replies, _timed(request, ready, model))
        except Exception as error:
            _say(replies, {"failed": f"{type(error).__name__}: {error}".splitlines()[0]})


def _timed(
    request: dict[str, Any], ready: dict[str, Model], model: Callable[[Case], Model]
) -> dict[str, float]:
    out, steps = request.pop("out"), request["steps"]
    key = json.dumps(request)
    if key not in ready:
        fields = np.load(request["fields"]) if request["fields"] else {}
        ready[key] = model(Case(**request, **{name: fields[name] for name in fields}))
        ready[key].run(ready[key].start(2), 2)
    made = ready[key]
    state = made.start(steps)
    cpu, wall = time.process_time(), time.perf_counter()
    with np.errstate(all="ignore"):
        state = made.run(state, steps)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    np.save(out, made.surface(state))
    return {"cpu": cpu, "wall": wall}


def _say(replies: Any, words: dict[str, Any]) -> None:
    replies.write(json.dumps(words) + "\n")
    replies.flush()
