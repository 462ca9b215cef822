"""The wall-shaped mixture and its search."""
