"""From observations to relative maps (Figs 8 to 12)."""
