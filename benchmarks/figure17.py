"""Figure 17: the trees of Victoria Park, mapped without ids and without odometry.

    python benchmarks/figure17.py DATA [-o FILE.png]

DATA is a folder with the real data sets. The reference is batch least squares with the published
tree ids over the same scans, rigidly aligned; it is other people's work and no surveyed truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from relmap import PointMapper
from relmap.datasets import open_log
from relmap.evaluation.run import run_mapper
from relmap.plots.victoria_park import compare_with_reference, write_panels_png

INTERVALS = ((1181, 1642), (4220, 4634))

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw Figure 17.")
    parser.add_argument("data", metavar="DATA", type=Path)
    parser.add_argument("-o", dest="file", metavar="FILE.png", type=Path, default="figure17.png")
    arguments = parser.parse_args()
    log = open_log(arguments.data / "victoria-park")
    panels = []
    for interval in INTERVALS:
        part = log.between(*interval)
        result = run_mapper(PointMapper(), part, "nearest", refine=True).result
        panels.append(compare_with_reference(result, part))
        print(panels[-1].title.replace("\n", ", "))
    write_panels_png(Path(arguments.file), panels)
