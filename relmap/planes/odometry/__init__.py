"""Odometry: predictions for a scan, and factors for the refinement."""
