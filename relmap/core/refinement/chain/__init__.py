"""Refinement with odometry: a chain of poses connects what landmarks alone leave apart."""
