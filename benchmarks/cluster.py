"""Throws over a Dask cluster of two workers on this machine, against the built-in threads.

    python benchmarks/cluster.py --throws 10000000

Both simulate the same releases in turn; prints the speeds, their ratio, and whether the counts agree. Rates include the whole
run, with the loading of kernels by the workers. The machine should be idle.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from concurrent.futures import Executor
from pathlib import Path

from distributed import LocalCluster

from diethrow.commands.model.face_odds import OddsPlan, odds
from diethrow.executors import cluster_at
from diethrow.model.die import make_die


def main() -> None:
    """Throw here and there, and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--throws", type=int, default=10_000_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=1)
    options = parser.parse_args()
    plan = OddsPlan(die=make_die("cube", 0.02, 0.016), chi=(0.5,), omega_rad_s=40.0, throws=options.throws, after=0)
    print(f"load before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores", flush=True)
    with (
        tempfile.TemporaryDirectory() as temporary,
        LocalCluster(n_workers=options.workers, threads_per_worker=1, dashboard_address=None) as cluster,
        cluster_at(cluster.scheduler_address) as executor,
    ):
        for repeat in range(options.repeats):
            out = Path(temporary) / f"{repeat}"
            here_s, here = thrown(plan, out / "here", options.workers, None)
            there_s, there = thrown(plan, out / "there", options.workers, executor)
            print(
                f"{options.throws} throws: threads {here_s:.1f} s, cluster {there_s:.1f} s, "
                f"speed of the cluster {here_s / there_s:.2f} times; counts {'the same' if here == there else 'DIFFER'}",
                flush=True,
            )


def thrown(plan: OddsPlan, out: Path, threads: int, executor: Executor | None) -> tuple[float, bytes]:
    """Seconds of a whole run, and its table of counts."""
    begin = time.perf_counter()
    odds(plan, out, threads=threads, executor=executor)
    return time.perf_counter() - begin, (out / "odds.csv").read_bytes()


if __name__ == "__main__":
    main()
