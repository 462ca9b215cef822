"""Pictures of runs; matplotlib is loaded only when one is drawn."""
