"""How good a result is: runs, metrics and the truth."""
