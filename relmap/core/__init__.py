"""The engine shared by all variants; independent of the kind of landmark."""
