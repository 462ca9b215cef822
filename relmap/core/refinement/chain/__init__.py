"""Refinement by single observations: a chain of poses, which odometry connects if there is any."""
