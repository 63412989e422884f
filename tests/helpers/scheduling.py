"""Which worker runs which file of tests, so that few trace the same program.

Tests of one package call the same compiled programs. A process that runs many of its files traces
each program once, where files spread over all processes have each of them trace it.
"""

from collections import Counter

from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController


class ByPackage(LoadFileScheduling):
    """Files whole, and each worker's from one package while that has any."""

    def _assign_work_unit(self, node: WorkerController) -> None:
        """Of the package it is on; else of one that no worker is on; else of the one least done."""
        own = [_package(file) for file in self.assigned_work[node]][-1:]
        waiting = Counter(map(_package, self.workqueue))
        others = (files for worker, files in self.assigned_work.items() if worker is not node)
        busy = Counter(_package(list(files)[-1]) for files in others if files)

        def rank(name: str) -> tuple[bool, bool, float]:
            return [name] == own, not busy[name], busy[name] and waiting[name] / (1 + busy[name])

        package = max(waiting, key=rank)
        first = next(file for file in self.workqueue if _package(file) == package)
        self.workqueue.move_to_end(first, last=False)
        super()._assign_work_unit(node)


def _package(file: str) -> str:
    return file.split("/")[1]
