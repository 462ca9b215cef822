"""The methods that can be compared, by name, and the run of one of them."""
