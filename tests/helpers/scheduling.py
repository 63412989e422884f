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
        done = [_package(file) for file in self.assigned_work[node]]
        waiting = Counter(map(_package, self.workqueue))
        # Else one that no other is on, the first; else that with most files for each worker on it.
        busy = Counter(
            _package(list(files)[-1])
            for worker, files in self.assigned_work.items()
            if worker is not node and files
        )
        package = max(
            waiting,
            key=lambda name: (
                done[-1:] == [name],
                not busy[name],
                waiting[name] / (1 + busy[name]) if busy[name] else 0,
            ),
        )
        first = next(file for file in self.workqueue if _package(file) == package)
        self.workqueue.move_to_end(first, last=False)
        super()._assign_work_unit(node)


def _package(file: str) -> str:
    return file.split("/")[1]
