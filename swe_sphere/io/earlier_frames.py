"""What a run that goes on in its own file keeps of it: frames and samples of earlier times."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.growing import Growing
from swe_sphere.io.layout import SERIES
from swe_sphere.io.runfile import RunFile, reading

KEPT = ("run_id", "start_step", "history")
"""Attributes that stay those of the run that is gone on with."""


class EarlierFrames:
    """The frames and samples in a file of a run that are of times before a given one [s].

    Later ones, by a run that was killed before its next checkpoint, are left out: the run that goes
    on writes them again.  Raises ConfigError if the file is damaged.
    """

    def __init__(self, path: Path, time: float) -> None:
        run = RunFile(path)
        times, self._series = run.series()
        self._path, self._sample_times = path, times[times < time]
        self._frames = int(np.count_nonzero(run.times < time))
        self.samples = self._sample_times.size
        """How many samples there are."""
        self.all_frames = run.times.size
        """How many frames there are in the file, with the later ones."""
        self.all_bytes = path.stat().st_size
        self.attributes = {k: run.attributes[k] for k in KEPT if k in run.attributes}

    def copy(self, target: Growing, series: Sequence[str]) -> None:
        """Write all into a file that has none yet; NaN for samples of a series that is new.

        Raises ConfigError if that file has other fields, and OSError as the system does.
        """
        for values in self._records(target.recorded):
            target.add_record(values, sync=False)
        missing = np.full(self.samples, np.nan)
        columns = {name: self._series.get(name, missing) for name in series}
        for k, time in enumerate(self._sample_times):
            numbers = {name: values[k] for name, values in columns.items()}
            target.add_sample({SERIES: time, **numbers})

    def _records(self, names: frozenset[str]) -> Iterator[dict[str, Array]]:
        with reading(self._path) as dataset:
            found = {name for name, v in dataset.variables.items() if "time" in v.dimensions}
            if found != names:
                raise ConfigError(f"cannot go on in {self._path}: its frames hold other fields")
            for k in range(self._frames):
                yield {name: dataset[name][k] for name in names}
