"""Map a planar world with known ids: two columns instead of three."""

import numpy as np

from relmap import PointMapper

rng = np.random.default_rng(1)
trees_map = rng.uniform(0.0, 20.0, (40, 2))

mapper = PointMapper()
for step in range(80):
    position_map = np.array([0.2 * step, 10.0])
    points_robot = trees_map - position_map + rng.normal(0.0, 0.05, trees_map.shape)
    near = np.flatnonzero(np.linalg.norm(points_robot, axis=1) < 8.0)
    mapper.update(points_robot[near], ids=near)
mapper.finish()

table = mapper.landmarks
for label, position, sd in list(zip(table.landmark, table.position, table.sd, strict=True))[:5]:
    print(f"tree {label}: x {position[0]:.2f} m, y {position[1]:.2f} m, uncertain by {sd:.3f} m")
