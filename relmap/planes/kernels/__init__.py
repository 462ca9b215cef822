"""The hot loops of mapping walls, compiled; see `relmap.core.kernels`."""
