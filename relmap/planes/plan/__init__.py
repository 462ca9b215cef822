"""The floor plan: which refined walls exist, and where they end."""
