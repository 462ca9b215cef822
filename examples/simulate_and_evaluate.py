"""Simulate a figure eight, map it and compare the map with the truth, all in Python."""

from relmap import PointMapper
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import truth_of
from relmap.simulation import simulate_figure_eight

world = simulate_figure_eight(density=25.0, iterations=300, sigma=0.05, seed=0)
run = run_mapper(PointMapper(), world.log, association="known")

evaluation = evaluate(run.result, truth_of(world), world.log)

print(f"landmark RMSE {evaluation.landmark_rmse_m:.3f} m, ATE {evaluation.ate_m:.3f} m")
print(f"{evaluation.coverage:.0%} of the landmarks seen at least ten times are in the map")
print(f"{run.result.summary['timing']['median_ms']:.2f} ms per iteration")
