"""The same place again: submaps that are tied, and localisation in a map."""
