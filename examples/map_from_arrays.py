"""Map landmarks from plain arrays: one call per scan, without files."""

import numpy as np

from relmap import PointMapper

rng = np.random.default_rng(0)
landmarks_map = rng.uniform(-10.0, 10.0, (30, 3))

mapper = PointMapper()
for step in range(60):
    # The robot drives ahead by 10 cm a step and turns a little; the mapper does not know this.
    angle = 0.01 * step
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    position_map = np.array([0.1 * step, 0.0, 0.0])
    points_robot = (landmarks_map - position_map) @ turn
    points_robot += rng.normal(0.0, 0.02, points_robot.shape)
    labels = mapper.update(points_robot)
mapper.finish()

print(f"{len(mapper.map.positions)} landmarks mapped")
print("the first one, metres:", mapper.map.positions[0].round(2))
print("final position of the robot, metres:", mapper.trajectory[-1][:3, 3].round(2))
