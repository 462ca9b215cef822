"""Alternative methods of finding planes, for comparison."""
