"""A study that costs nothing, for the tests of the harness and the processes they start."""

import dataclasses
import os
import signal
import time

import numpy as np
from studies.study import Study
from studies.worker import clocked

from spectra_kit.errors import InvalidInputError


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Toy(Study[str, int]):
    """Counts, and leaves a file for every count."""

    name = "toy"
    option: str = ""

    def facts(self, contender, problem):
        return {"contender": contender, "problem": problem, "option": self.option}

    def excuse(self, contender, problem, before):
        stopped = [r for r in before if r.contender == contender and r.record["status"] != "ok"]
        return f"not at {stopped[0].problem}" if stopped else ""

    def measure(self, contender, problem):
        with (self.folder / "calls").open("a") as file:
            file.write(f"{contender} {problem}\n")
        if contender == "fails":
            raise InvalidInputError("`problem` must be easier")
        if contender == "dies":
            os._exit(7)
        if contender == "leaves a child":  # with all that it had open
            if os.fork() == 0:
                time.sleep(60)
            os.kill(os.getpid(), signal.SIGKILL)
        if contender == "waits":
            with clocked():
                time.sleep(60)
        path = self.file(contender, problem, ".npy")
        np.save(path, np.arange(problem))
        threads = os.environ.get("OMP_NUM_THREADS", "")
        return {"total": problem, "threads": threads, "files": [f"files/{path.name}"]}


class Lasting(Toy):
    """One process for all."""

    fresh = False

    def measure(self, contender, problem):
        return {"process": os.getpid()}


def toy(folder, contenders=("a", "b"), problems=(1, 2), kind=Toy, **options):
    return kind(folder=folder, contenders=contenders, problems=problems, **options)


def calls(folder):
    path = folder / "calls"
    return path.read_text().splitlines() if path.exists() else []


def clock_ones(size):
    """Clock that many numbers, and a pause."""
    with clocked() as found:
        ones = np.ones(size)
        time.sleep(0.05)
    assert len(ones) == size
    return vars(found)
