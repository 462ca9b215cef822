"""The global map: alignment and placement of relative maps."""
