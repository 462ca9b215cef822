"""Joint least squares over all observations."""
